"""Predictions of a trained model by frame number, and refused files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.train import checkpoint, predict, windows
from pipeline.train.labelled_drive import Timeline, read_drives
from tests import artefacts
from tests.pipeline.train.shared import DRIVES

WINDOW = 4
NUMBERS = np.array([*range(10, 22), *range(25, 36), 40])  # runs of 12, 11 and 1 frames
STEERING = 0.1 * np.sin(NUMBERS / 5)


def write_model(folder: Path, contents: dict[str, Any] | None = None, **line: object) -> Path:
    """Write a best.pt with random weights."""
    torch.manual_seed(0)
    general = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": WINDOW, "features": 8}
    options = {} if "spatial" in line else {"semantics": 0.0}
    entry, contents = Entry.model_validate(general | options | line), contents or {"kind": "graph"}
    target = {"mean_rad": 0.01, "std_rad": 0.12, "wheelbase_m": 2.7, "min_speed_mps": 1.0}
    net = entry.build(**contents).state_dict()
    best = {"name": "net", "seed": 0, "fold": None, "contents": contents, "target": target}
    best |= {"model": entry.model_dump(mode="json")}
    checkpoint.write(folder / "best.pt", best | {"net": net, "kind": predict.KIND})
    return folder


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> predict.Trained:
    return predict.load(write_model(tmp_path_factory.mktemp("model") / "net"), "cpu")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.h5"
    artefacts.write_graphs(path, "drive", STEERING, NUMBERS, 40, np.random.default_rng(0))
    return path


def test_shared_frames_equal_naive_windows_and_gaps_are_nan(model: predict.Trained, drive: Path) -> None:
    with graph_file.open_graphs(drive) as graphs:
        steering_rad = model.predict(graphs)
        timeline = Timeline.read(graphs)
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
        by_number = dict(zip(NUMBERS.tolist(), steering_rad, strict=True))
        for numbers in ([35, 13, 28, 40, 13], np.array([20]), []):
            some = model.predict(graphs, numbers)
            assert some.dtype == np.float64
            assert some == pytest.approx([by_number[int(n)] for n in numbers], abs=1e-6, nan_ok=True)
        for wrong, missing in (([20, 23, 24], "no frame 23 .*10 to 40"), ([20.5], r"no frame 20\.5")):
            with pytest.raises(InputError, match=missing):
                model.predict(graphs, wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("base", ["motion", "none"])
def test_output_zero_is_the_base_angle(tmp_path: Path, base: str) -> None:
    drive = tmp_path / "drive.h5"
    artefacts.write_graphs(drive, "drive", STEERING, NUMBERS, 40, np.random.default_rng(0))
    model = predict.load(write_model(tmp_path / "net", motion="visual", base=base, horizon=3), "cpu")
    assert model.entry.horizon == 3
    with graph_file.open_graphs(drive) as graphs, pytest.raises(InputError, match="no measured motion"):
        model.predict(graphs)
    artefacts.add_motion(drive, STEERING)
    with torch.no_grad():
        for weights in model.net.parameters():
            weights.zero_()
    with graph_file.open_graphs(drive) as graphs:
        for output in (0.0, 1.0):
            model.net.temporal.output_shift.data.fill_(output)
            steering_rad = model.predict(graphs)
            finite = np.isfinite(steering_rad)
            base_rad = STEERING[finite] if base == "motion" else 0.0
            assert finite.sum() == (12 - 3) + (11 - 3)
            assert steering_rad[finite] == pytest.approx(base_rad + 0.12 * output, abs=1e-6)


def test_a_symlink_loop_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="no trained model"):
        predict.load(tmp_path / "loop")


def test_folder_of_a_model(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "train/net")
    model = predict.load(str(folder), device="cpu")
    assert (model.name, model.seed, model.entry.window, model.entry.temporal) == ("net", 0, WINDOW, "ncp")
    assert not model.net.training
    for missing, fix in (("nott", "train@nott"), ("train", "net"), ("train/nott", "beside it: net")):
        with pytest.raises(InputError, match=r"best\.pt is missing") as raised:
            predict.load(tmp_path / missing)
        assert fix in raised.value.fix
    best = checkpoint.read(folder / "best.pt", predict.KIND)
    best["model"] = {key: value for key, value in best["model"].items() if key != "base"}  # as before this setting
    checkpoint.write(folder / "best.pt", best | {"kind": predict.KIND})
    assert predict.load(folder).entry.base == "motion"
    config = {"model": model.entry.model_dump(mode="json"), "seeds": [0], "parameters": 1, "best_sha256": "0"}
    store.write_json(folder / "config.json", config)
    with pytest.raises(InputError, match="different runs"):
        predict.load(folder)


def test_target_is_the_scale_of_the_residual(tmp_path: Path) -> None:
    name = next(iter(DRIVES))
    artefacts.write_dataset(tmp_path, {name: "train"}, frames=40, points=12)
    graphs, labels = tmp_path / "graphs/semantic", tmp_path / "labels"
    (plain,) = read_drives(graphs, labels, [name], WINDOW, horizon=5)
    artefacts.add_motion(graphs / f"{name}.h5", np.full(40, 0.05))
    (drive,) = read_drives(graphs, labels, [name], WINDOW, horizon=5, motion="visual")
    drive.valid[:10] = False
    target = predict.Target.from_drives([drive])
    assert target.mean_rad == pytest.approx(plain.steering_rad[10:35].mean())
    assert target.std_rad == pytest.approx(plain.steering_rad[10:35].std())  # a constant base does not change it
    assert (target.wheelbase_m, target.min_speed_mps) == (2.7, 1.0)
    held, steering = drive.measured_rad["visual"][10:35], plain.steering_rad[10:35]
    assert target.coefficients == {"visual": pytest.approx(held @ steering / (held @ held))}
    drive.base_rad[:] = np.nan_to_num(drive.steering_rad) - 0.02
    assert predict.Target.from_drives([drive]).std_rad == pytest.approx(1e-6)


FORGED: dict[str, Any] = {
    "contents.kind": "cloud",
    "contents": None,
    "model.spatial": "../../os",
    "model.layers": [0],
    "model.layerz": "wide",
    "model.window": True,
    "model": [1],
    "target.std_rad": float("nan"),
    "target.coefficients": {"visual": "x"},
    "card": {"drives": 3},
    "seed": None,
    "net": {"weight": 1},
    "name": ["net"],
}


@pytest.mark.parametrize("key", FORGED)
def test_a_forged_checkpoint_is_one_line(tmp_path: Path, key: str) -> None:
    path = write_model(tmp_path / "train/net") / "best.pt"
    content: Any = checkpoint.read(path, predict.KIND)
    section, _, name = key.partition(".")
    if name:
        content[section][name] = FORGED[key]
    else:
        content[section] = FORGED[key]
    checkpoint.write(path, content)
    with pytest.raises(InputError) as raised:
        predict.load(path.parent, "cpu")
    assert str(path) in raised.value.where
    assert "\n" not in str(raised.value)


def test_a_loop_of_links_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "net").symlink_to(tmp_path / "net")
    with pytest.raises(InputError, match=r"best\.pt is missing"):
        predict.load(tmp_path / "net")
    (tmp_path / "seed-1").mkdir()
    (tmp_path / "seed-1/best.pt").symlink_to("best.pt")
    with pytest.raises(InputError, match=r"best\.pt is missing"):
        predict.load(tmp_path / "seed-1")
