"""Predictions of a trained model, refused checkpoints, and the runs of a model."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.train import checkpoint, predict, runs, windows
from pipeline.train.fit import Epoch, selected_epoch
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
    content |= {"drives": ["a"], "fps": 10.0, "net": model.build("graph").state_dict()}
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
            batch = windows.read_batch([timeline], {0: graphs}, [span], WINDOW)
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
CHANGES |= {"net": {"weight": torch.zeros(1)}}


@pytest.mark.parametrize("key", CHANGES)
def test_a_checkpoint_of_another_version_is_one_line(tmp_path: Path, key: str) -> None:
    path = write_model(tmp_path / "net") / "best.pt"
    checkpoint.write(path, checkpoint.read(path, predict.KIND) | {key: CHANGES[key]})
    with pytest.raises(InputError, match="Train it again") as raised:
        predict.load(path.parent, "cpu")
    assert str(path) in raised.value.where
    assert "\n" not in str(raised.value)


def test_a_missing_model_names_those_near_it(tmp_path: Path, drive: Path) -> None:
    write_model(tmp_path / "train/net")
    for missing in ("train", "train/nott"):
        with pytest.raises(InputError, match=r"best\.pt is missing.*train/net"):
            predict.load(tmp_path / missing)


class Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return (open, (str(self.path), "w"))


def test_code_in_a_file_does_not_run(tmp_path: Path) -> None:
    torch.save({"kind": "thing", "trap": Trap(tmp_path / "sprung")}, tmp_path / "x.pt")
    with pytest.raises(InputError, match="more than tensors"):
        checkpoint.read(tmp_path / "x.pt", "thing")
    assert not (tmp_path / "sprung").exists()


def test_missing_damaged_and_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a/x.pt"
    with pytest.raises(InputError, match="missing"):
        checkpoint.read(path, "thing")
    checkpoint.write(path, {"kind": "thing", "net": {"weight": torch.linspace(-1, 1, 500)}})
    assert torch.equal(checkpoint.read(path, "thing")["net"]["weight"], torch.linspace(-1, 1, 500))
    with pytest.raises(InputError, match=r"expected a checkpoint of .* other"):
        checkpoint.read(path, "other")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match="damaged"):
        checkpoint.read(path, "thing")


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"bias": None}, r'Missing key\(s\) in state_dict: "bias"'),
        ({"extra": torch.zeros(1)}, r'Unexpected key\(s\) in state_dict: "extra"'),
        ({"weight": torch.zeros(2, 9)}, r"size mismatch for weight: .*\[2, 9\]"),
        ({"bias": torch.full((2,), torch.nan)}, "bias has numbers that are not finite"),
        ({"bias": "two"}, "tensors by name"),
    ],
)
def test_a_state_must_match_exactly(change: dict[Any, object], fault: str) -> None:
    net = torch.nn.Linear(3, 2)
    state = {name: tensor + 1 for name, tensor in net.state_dict().items()}
    checkpoint.load_state(torch.nn.Linear(3, 2), state, Path("x.pt"))
    changed = {name: value for name, value in {**state, **change}.items() if value is not None}
    with pytest.raises(InputError, match=fault) as raised:
        checkpoint.load_state(net, changed, Path("x.pt"))
    assert "\n" not in str(raised.value)


SPLITS = {"a": "train", "x": "test", "b": "train", "v": "val", "y": "test", "z": "test"}
NOTHING = float("nan")


def test_without_folds_the_first_seed_has_the_models_folder() -> None:
    result = runs.runs(Path("data/train/gnn"), [3, 0], runs.folds(SPLITS, "train", None))
    assert [(run.seed, str(run.folder), str(run)) for run in result] == [
        (3, "data/train/gnn", "seed 3"),
        (0, "data/train/gnn/seed-0", "seed 0"),
    ]
    assert {run.fold for run in result} == {runs.Fold(None, ("a", "b"), ("v",), ("x", "y", "z"))}


@pytest.mark.parametrize(("fit_to", "left"), [("others", ()), ("both", ("a", "b"))])
def test_leave_one_out(fit_to: str, left: tuple[str, ...]) -> None:
    folds = runs.folds(SPLITS, fit_to, None)
    assert [fold.name for fold in folds] == ["x", "y", "z"]
    val = ("v",) if fit_to == "both" else ()
    assert folds[1] == runs.Fold("y", (*left, "x", "z"), val, ("y",))
    result = runs.runs(Path("data/train/gnn"), [0, 5], folds)
    assert [str(run.folder) for run in result[2:4]] == ["data/train/gnn/fold-z", "data/train/gnn/seed-5/fold-x"]
    assert str(result[2]) == "seed 0 without z"


def test_roads_are_the_first_training_drives() -> None:
    assert runs.folds(SPLITS, "train", 1)[0].train == ("a",)
    assert runs.folds(SPLITS, "both", 2)[0].train == ("a", "b", "y", "z")
    with pytest.raises(InputError, match="2 training drives"):
        runs.folds(SPLITS, "train", 3)
    with pytest.raises(InputError, match="two test drives"):
        runs.folds({"a": "test"}, "others", None)


@pytest.mark.parametrize(
    ("nmse", "selected"),
    [
        ((0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7), 6),  # the least mean of three, not the lucky second
        ((0.9, 0.8, NOTHING), 2),
        ((NOTHING, NOTHING), 2),  # without validation the last
        ((), 0),
    ],
)
def test_the_kept_epoch(nmse: tuple[float, ...], selected: int) -> None:
    assert selected_epoch([Epoch(number, 0.1, 0.1, error) for number, error in enumerate(nmse, start=1)]) == selected
