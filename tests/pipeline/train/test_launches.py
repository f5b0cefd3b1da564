"""Launches, blocking copies and synchronisations of training and validation, counted on a simulated GPU."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
import yaml

from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import fit, predict, reading, windows
from pipeline.train.labelled_drive import read_drives
from tests import artefacts, simulated_gpu, small_model

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
FRAMES = 60
UNEQUAL = partial(artefacts.write_graphs, spread=3)


class Counts(NamedTuple):
    launches: int
    copies: int
    synchronisations: int


class CountingReader:
    """Yield a reader's batches, and count launches, copies and synchronisations for each of them."""

    def __init__(self, reader: reading.Reader, gpu: simulated_gpu.Gpu) -> None:
        self._reader, self._gpu = reader, gpu
        self.counts: list[Counts] = []

    def batches(self, steps: Sequence[reading.TrainStep]) -> Iterator[dict[str, Any]]:
        for batch in self._reader.batches(steps):
            self._gpu.reset()
            yield batch
            self.counts.append(counted(self._gpu))

    def predictions(self, spans: Sequence[windows.Span]) -> Iterator[dict[str, Any]]:
        return self.batches([reading.TrainStep((span,)) for span in spans])


def counted(gpu: simulated_gpu.Gpu) -> Counts:
    return Counts(gpu.launches, len(gpu.copies), len(gpu.synchronisations))


def count(folder: Path, line: dict[str, object], write: Callable[..., None]) -> tuple[Counts, Counts, Counts]:
    """Return the counts of a training step, of a batch of validation, and of the rest of the pass, after its batches.

    The step is the last one of an epoch; the first one also allocates the optimiser's state.
    """
    artefacts.write_dataset(folder, DRIVES, FRAMES, write=write)
    entry = Entry.model_validate({"input": "semantic", "temporal": "ncp", "window": 8} | line)
    if entry.motion != "none":
        for name in DRIVES:
            path = folder / f"graphs/semantic/{name}.h5"
            artefacts.add_motion(path, entry.motion, np.linspace(-0.3, 0.4, FRAMES))
    drives = read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), entry.window, **entry.reading)
    with graph_file.open_graphs(drives[0].graphs) as graphs:
        contents = graphs.contents
    torch.manual_seed(0)
    net = entry.build(**contents.model_dump())
    settings = Train.model_validate(yaml.safe_load(small_model.PARAMS.read_text())["train"])
    with simulated_gpu.Gpu() as gpu:
        gpu.move(net)
        run = fit.Fit(net, entry.window, entry.alpha, settings, seed=0)
        target = predict.Target.from_drives(drives)
        with reading.Reader(drives, entry.window, net.device, run.targets(target), workers=0) as reader:
            counting: Any = CountingReader(reader, gpu)
            loss, _ = run._train(counting, drives, 1)
            step: Counts = counting.counts[-1]
            counting.counts.clear()
            mse, _ = run._validate(drives, target, counting.predictions)
            validation: Counts = counting.counts[-1]
            assert len(counting.counts) == len(drives)
        rest = Counts(*np.subtract(counted(gpu), validation))
    assert np.isfinite([loss, mse]).all()
    return step, validation, rest


GNN = {"spatial": "gnn", "semantics": 1.0}
MOTION = GNN | {"equivariant": True, "motion": "visual", "horizon": 10}


# The limits are the counts of this code, rounded up.
@pytest.mark.parametrize(
    ("line", "write", "launches", "validation"),
    [
        pytest.param(GNN, artefacts.write_graphs, 500, 320, id="sa-gnn-ncp"),
        pytest.param(GNN, UNEQUAL, 790, 500, id="sa-gnn-ncp, unequal frames"),
        pytest.param(GNN | {"temporal": "lstm"}, artefacts.write_graphs, 330, 140, id="gnn-lstm"),
        pytest.param(MOTION, artefacts.write_graphs, 530, 340, id="motion-10"),
        pytest.param({"spatial": "edgeconv"}, artefacts.write_graphs, 840, 450, id="edgeconv-ncp"),
        pytest.param({"spatial": "gatv2"}, artefacts.write_graphs, 1210, 570, id="gatv2-ncp"),
        pytest.param(GNN | {"sectors": 9}, UNEQUAL, 820, 520, id="gnn with sectors, unequal frames"),
        pytest.param({"spatial": "polar"}, UNEQUAL, 510, 340, id="polar-ncp, unequal frames"),
        pytest.param({"spatial": "pointnet2", "width": 0.25}, artefacts.write_sets, 760, 350, id="pointnet2-ncp"),
        pytest.param({"spatial": "cnn", "window": 16}, artefacts.write_images, 800, 540, id="cnn-ncp"),
    ],
)
def test_a_step_stays_within_its_budget(
    tmp_path: Path, line: dict[str, object], write: Callable[..., None], launches: int, validation: int
) -> None:
    step, batch, rest = count(tmp_path, line, write)
    assert step.launches <= launches
    assert batch.launches <= validation
    assert not step.copies + batch.copies + rest.copies
    assert not step.synchronisations + batch.synchronisations
    assert rest.synchronisations == len(DRIVES)  # reading the predictions of each batch, after the last one


def test_an_operator_on_both_devices_fails() -> None:
    with simulated_gpu.Gpu() as gpu:
        there = torch.ones(3).to(simulated_gpu.GPU)
        assert there.device == simulated_gpu.GPU
        with pytest.raises(RuntimeError, match="tensors of both devices"):
            there + torch.ones(3)
        assert (there + 1).sum().item() == 6
    assert gpu.launches == 3  # the addition, the sum, and reading it
    assert len(gpu.copies) == len(gpu.synchronisations) == 1
