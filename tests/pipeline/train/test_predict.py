"""A trained model in Python: what it says of frames by number, and what it refuses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from models.steering.core import steering_net
from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint
from pipeline.sections.models import Model
from pipeline.train import frames, predict, windows
from tests import artefacts

WINDOW = 4
CONTENTS: dict[str, Any] = {"kind": "graph"}
NUMBERS = np.array([*range(10, 22), *range(25, 36), 40])  # runs of 12, 11 and 1 frames


def write_model(folder: Path, contents: dict[str, Any] = CONTENTS, **line: object) -> Path:
    torch.manual_seed(0)
    resolved = Model.model_validate(
        {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": WINDOW, "features": 8} | line
    ).model_dump()
    best = {"name": "net", "seed": 0, "fold": None, "model": resolved, "contents": contents, "kind": predict.KIND}
    best["target"] = {"mean_rad": 0.01, "std_rad": 0.12, "wheelbase_m": 2.7, "min_speed_mps": 1.0}
    best["net"] = steering_net.build(resolved, **contents).state_dict()
    checkpoint.write(folder / "best.pt", best)
    return folder


@pytest.fixture
def model(tmp_path: Path) -> predict.Trained:
    return predict.load(write_model(tmp_path / "train/net"), "cpu")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path, rng = tmp_path / "drive.h5", np.random.default_rng(0)
    artefacts.write_graphs(path, "drive", 0.1 * np.sin(NUMBERS / 5), NUMBERS, 40, rng)
    return path


def test_shared_frames_say_what_naive_windows_say_and_gaps_say_nothing(model: predict.Trained, drive: Path) -> None:
    with frames.open_graphs(drive) as graphs:
        every = model.predict(graphs)
        timeline = windows.Timeline.of(graphs)
        for row, number in enumerate(NUMBERS):
            before = NUMBERS[max(0, row - WINDOW + 1) : row + 1]
            if len(before) < WINDOW or number - before[0] >= WINDOW:
                assert np.isnan(every[row])
                continue
            span = windows.Span(0, row - WINDOW + 1, row + 1)
            (batch,) = windows.batches([timeline], [[span]], WINDOW, {0: graphs})
            with torch.inference_mode():
                alone = 0.12 * steering_net.predict(model.net, batch).item()
            assert every[row] == pytest.approx(alone, abs=1e-6)
    assert np.isfinite(every).sum() == (12 - 3) + (11 - 3)


def test_frames_come_in_the_order_asked_for(model: predict.Trained, drive: Path) -> None:
    with frames.open_graphs(drive) as graphs:
        every = dict(zip(NUMBERS.tolist(), model.predict(graphs), strict=True))
        for numbers in ([35, 13, 28, 40, 13], np.array([20]), []):
            steering_rad = model.predict(graphs, numbers)
            assert steering_rad.dtype == np.float64
            assert steering_rad == pytest.approx([every[int(n)] for n in numbers], abs=1e-6, nan_ok=True)


def test_each_frame_is_encoded_once_and_no_more_than_needed(model: predict.Trained, tmp_path: Path) -> None:
    count = predict.WINDOWS + 30
    write = (tmp_path / "long.h5", "long", np.zeros(count), np.arange(count), 12, np.random.default_rng(0))
    artefacts.write_graphs(*write)
    encoded: list[int] = []
    model.net.register_forward_pre_hook(lambda _, arguments: encoded.append(arguments[0].frames))
    with frames.open_graphs(tmp_path / "long.h5") as graphs:
        for numbers, expected in (
            ([60, 61, 100], [WINDOW + 1, WINDOW]),
            ([2], []),
            (None, [predict.WINDOWS + WINDOW - 1, 30]),  # what is read at a time does not grow with the drive
        ):
            encoded.clear()
            model.predict(graphs, numbers)
            assert encoded == expected


def test_frames_that_are_not_there_are_named(model: predict.Trained, drive: Path) -> None:
    with frames.open_graphs(drive) as graphs:
        with pytest.raises(InputError, match=r"drive\.h5 has no frame 23\b.* 10 to 40"):
            model.predict(graphs, [20, 23, 24])
        with pytest.raises(InputError, match=r"no frame 20\.5"):
            model.predict(graphs, [20.5])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("contents", "line", "words"),
    [
        ({"kind": "image", "image_size": (32, 96)}, {"spatial": "cnn"}, "expects images of 32 x 96.*holds kNN graphs"),
        ({"kind": "pointnet2", "levels": 2}, {"spatial": "pointnet2"}, r"expects points.* 2 levels.*holds kNN graphs"),
    ],
)
def test_another_kind_of_frames_is_refused(
    tmp_path: Path, drive: Path, contents: dict[str, Any], line: dict[str, str], words: str
) -> None:
    model = predict.load(write_model(tmp_path / "net", contents, **line))
    with frames.open_graphs(drive) as graphs, pytest.raises(InputError, match=rf"net {words}.* input: semantic"):
        model.predict(graphs)


def test_with_motion_the_answer_adds_to_the_measured_angle(tmp_path: Path, drive: Path) -> None:
    driven = 0.1 * np.sin(NUMBERS / 5)
    model = predict.load(write_model(tmp_path / "net", motion="visual", horizon=3), "cpu")
    assert model.horizon == 3
    with (
        frames.open_graphs(drive) as graphs,
        pytest.raises(InputError, match=r"net: .*carries no motion: visual \(it has none\)"),
    ):
        model.predict(graphs)
    artefacts.add_motion(drive, "visual", driven)
    with torch.no_grad():
        for weights in model.net.parameters():
            weights.zero_()
    with frames.open_graphs(drive) as graphs:
        steering_rad = model.predict(graphs)
        answer = predict.over_drives(model.net, lambda *_: torch.ones(1), [windows.Timeline.of(graphs)], WINDOW,
                                     model.target, rows=[np.array([5])], opened={0: graphs})  # fmt: skip
    seen = np.isfinite(steering_rad)
    assert seen.sum() == (12 - 3) + (11 - 3)
    assert steering_rad[seen] == pytest.approx(driven[seen], abs=1e-6)
    assert answer[0][5] == pytest.approx(0.12)


def test_an_older_checkpoint_is_told_by_what_it_lacks(tmp_path: Path) -> None:
    path = write_model(tmp_path / "net") / "best.pt"
    content = checkpoint.read(path, predict.KIND)
    del content["target"]["wheelbase_m"], content["model"]["horizon"]
    checkpoint.write(path, content)
    with pytest.raises(InputError, match=r"lacks model\.horizon, target\.wheelbase_m: an older .*-item train@net$"):
        predict.load(path.parent)


def test_a_folder_is_named_by_path_or_text(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "net")
    for name in (folder, str(folder)):
        model = predict.load(name, device="cpu")
        assert (model.name, model.seed, model.window, model.line["temporal"]) == ("net", 0, WINDOW, "ncp")
        assert not model.net.training


def test_a_folder_that_is_not_a_trained_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nott is not a trained model, best\.pt is missing.* repro train@nott"):
        predict.load(tmp_path / "nott")
    write_model(tmp_path / "train/net")
    with pytest.raises(InputError, match=r"train is not a trained model.*best\.pt.*in it: net"):
        predict.load(tmp_path / "train")


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"kind": "unified encoder"}, "not a checkpoint of"),
        ({"contents": None}, "lacks contents"),
        ({"model": {"spatial": "wavelet"}}, r"spatial.*wavelet"),
        ({"model": {"features": 7}}, "does not fit"),
    ],
)
def test_a_file_that_does_not_rebuild_a_network_is_refused(tmp_path: Path, change: dict[str, Any], fault: str) -> None:
    path = write_model(tmp_path / "net/seed-7") / "best.pt"
    content = checkpoint.read(path, predict.KIND)
    for key, value in change.items():
        content[key] = content[key] | value if isinstance(value, dict) else value
    checkpoint.write(path, {key: value for key, value in content.items() if change.get(key, True) is not None})
    with pytest.raises(InputError, match=rf"best\.pt.*{fault}.* dvc repro --force --single-item train@net$"):
        predict.load(path.parent)


def test_target_of_a_straight_road_has_a_spread_to_divide_by(tmp_path: Path) -> None:
    names = ["2026_01_01_drive_0001"]
    artefacts.write_dataset(tmp_path, dict.fromkeys(names, "train"), frames=12, points=20)
    (bends,) = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", names, WINDOW)
    target = predict.Target.of([bends])
    assert target.std_rad == pytest.approx(bends.steering_rad.std())
    bends.steering_rad[:] = 0.05
    assert predict.Target.of([bends]).mean_rad == pytest.approx(0.05)
    assert predict.Target.of([bends]).std_rad > 0


def test_the_target_spreads_as_what_motion_leaves_open(tmp_path: Path) -> None:
    name = "2026_01_01_drive_0001"
    artefacts.write_dataset(tmp_path, {name: "train"}, frames=40, points=12)
    graphs, labels = tmp_path / "graphs/semantic", tmp_path / "labels"
    (plain,) = windows.read_drives(graphs, labels, [name], WINDOW, 5)
    artefacts.add_motion(graphs / f"{name}.h5", "lidar", np.full(40, 0.05))
    (moved,) = windows.read_drives(graphs, labels, [name], WINDOW, 5, "lidar")
    moved.valid[:10] = False
    target = predict.Target.of([moved])
    assert target.mean_rad == pytest.approx(plain.steering_rad[10:35].mean())
    assert target.std_rad == pytest.approx(plain.steering_rad[10:35].std())  # a constant leaves all the spread
    assert (target.wheelbase_m, target.min_speed_mps) == (2.7, 1.0)
    moved.base_rad[:] = np.nan_to_num(moved.steering_rad) - 0.02
    assert predict.Target.of([moved]).std_rad == pytest.approx(1e-6)
