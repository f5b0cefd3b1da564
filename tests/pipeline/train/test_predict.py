"""Predictions of a trained model by frame number, and refused files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.train import checkpoint, predict, windows
from pipeline.train.labelled_drive import Timeline
from tests import artefacts

WINDOW = 4
NUMBERS = np.array([*range(10, 22), *range(25, 36), 40])  # stretches of 12, 11 and 1 frames
STEERING = 0.1 * np.sin(NUMBERS / 5)


def write_model(folder: Path, **entry: object) -> Path:
    """Write a best.pt with random weights."""
    torch.manual_seed(0)
    general = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "semantics": 1.0, "features": 8}
    model = Entry.model_validate(general | {"window": WINDOW} | entry)
    scale = {"names": ["steering_rad"], "gain": [1.0], "std": [0.12], "mean": [0.01], "odometry_gain": None}
    content = {"kind": predict.KIND, "name": "net", "seed": 0, "seeds": [0], "fold": None, "scale": scale}
    content |= {"contents": {"kind": "graph"}, "entry": model.model_dump(mode="json"), "settings": artefacts.LABELS}
    content |= {"card": {"drives": ["a"], "fps": 10.0}, "net": model.build("graph").state_dict()}
    checkpoint.write(folder / "best.pt", content)
    return folder


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "drive.h5"
    artefacts.write_graphs(path, "drive", STEERING, NUMBERS, 40, np.random.default_rng(0))
    return path


def test_shared_frames_equal_naive_windows_and_gaps_are_nan(tmp_path: Path, drive: Path) -> None:
    model = predict.load(str(write_model(tmp_path / "net")), "cpu")
    assert (model.name, model.seed, model.entry.window, model.car.wheelbase_m) == ("net", 0, WINDOW, 2.7)
    assert not model.net.training
    with graph_file.open_graphs(drive) as graphs:
        steering_rad = model.predict(graphs).mean[:, 0]
        timeline = Timeline.read(graphs, model.car)
        for row, number in enumerate(NUMBERS):
            before = NUMBERS[max(0, row - WINDOW + 1) : row + 1]
            if len(before) < WINDOW or number - before[0] >= WINDOW:
                assert np.isnan(steering_rad[row])
                continue
            span = windows.Span(0, row - WINDOW + 1, row + 1)
            (batch,) = windows.batches([timeline], [[span]], WINDOW, {0: graphs})
            with torch.inference_mode():
                assert steering_rad[row] == pytest.approx(0.12 * model.net(*model.net.inputs(batch)).item(), abs=1e-6)
        assert np.isfinite(steering_rad).sum() == (12 - 3) + (11 - 3)


@pytest.mark.parametrize("base", ["motion", "none"])
def test_output_zero_is_the_base_angle(tmp_path: Path, drive: Path, base: str) -> None:
    model = predict.load(write_model(tmp_path / "net", motion="visual", base=base, horizon=3), "cpu")
    with graph_file.open_graphs(drive) as graphs, pytest.raises(InputError, match="no measured motion"):
        model.predict(graphs)
    artefacts.add_motion(drive, STEERING)
    with torch.no_grad():
        for weights in model.net.parameters():
            weights.zero_()
    with graph_file.open_graphs(drive) as graphs:
        for output in (0.0, 1.0):
            model.net.temporal.output_shift.data.fill_(output)
            steering_rad = model.predict(graphs).mean[:, 0]
            finite = np.isfinite(steering_rad)
            base_rad = STEERING[finite] if base == "motion" else 0.0
            assert steering_rad[finite] == pytest.approx(base_rad + 0.12 * output, abs=1e-6)


CHANGES: dict[str, Any] = {"entry": {"spatial": "nothing"}, "contents": {"kind": "pointnet2"}, "scale": None}
CHANGES |= {"net": {"weight": torch.zeros(1)}, "seed": ...}


@pytest.mark.parametrize("key", CHANGES)
def test_a_checkpoint_of_another_version_is_one_line(tmp_path: Path, key: str) -> None:
    path = write_model(tmp_path / "net") / "best.pt"
    content = checkpoint.read(path, predict.KIND) | {key: CHANGES[key]}
    checkpoint.write(path, {name: value for name, value in content.items() if value is not ...})
    with pytest.raises(InputError, match="Train it again") as raised:
        predict.load(path.parent, "cpu")
    assert str(path) in raised.value.where
    assert "\n" not in str(raised.value)


def test_a_missing_model_names_those_near_it(tmp_path: Path, drive: Path) -> None:
    write_model(tmp_path / "train/net")
    for missing in ("train", "train/nott"):
        with pytest.raises(InputError, match=r"best\.pt is missing.*train/net"):
            predict.load(tmp_path / missing)
