"""Drives with their targets, spans of windows, batches against single frames, and their augmentation."""

from collections.abc import Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import Arrays, collate, open_graphs
from pipeline.train import reading, windows
from pipeline.train.labelled_drive import LabelledDrive, consecutive, read_drives
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
NAME = next(iter(DRIVES))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Drives that a test may change."""
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=12)
    return tmp_path


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Drives that no test changes."""
    folder = tmp_path_factory.mktemp("windows")
    artefacts.write_dataset(folder, DRIVES, frames=23, points=12)
    return folder


def read(folder: Path, window: int = 8, **reading: object) -> list[LabelledDrive]:
    return read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), window, **reading)


def read_batch(drives: Sequence[LabelledDrive], *group: windows.Span, window: int = 8) -> Arrays:
    with ExitStack() as stack:
        files = {span.drive: stack.enter_context(open_graphs(drives[span.drive].graphs)) for span in group}
        return windows.read_batch(drives, files, group, window)


def test_consecutive_frames_end_at_a_gap() -> None:
    assert consecutive(np.array([3, 4, 5, 9, 10, 12])) == ((0, 3), (3, 5), (5, 6))
    assert consecutive(np.array([], int)) == ()


def test_spans_cover_each_window_once(original: Path) -> None:
    drives = read(original)
    random = [windows.random_spans(drives, 8, 5, np.random.default_rng(seed)) for seed in range(20)]
    for spans in (windows.spans(drives, 8, 5), *random):
        ends = [(span.drive, row) for span in spans for row in range(span.start + 7, span.stop)]
        assert sorted(ends) == [(number, row) for number in range(2) for row in range(7, 23)]
        assert all(span.stop - span.start - 7 <= 5 for span in spans)


def test_batch_of_two_spans_equals_single_frames(original: Path) -> None:
    drives = read(original)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    batch = read_batch(drives, *group)
    assert batch["windows"].shape == batch["dt_s"].shape == (4 + 2, 8)
    assert batch["windows"][3:5].tolist() == [[*range(3, 11)], [*range(11, 19)]]
    frame = 0
    for span in group:
        with open_graphs(drives[span.drive].graphs) as graphs:
            for row in range(span.start, span.stop):
                alone, (first, last) = collate([(graphs, row, row + 1)]), batch["ptr"][frame : frame + 2]
                edges = slice(*np.concatenate([[0], np.cumsum(batch["degree"], dtype=np.int64)])[[first, last]])
                assert (batch["xyz"][first:last] == alone["xyz"]).all()
                assert (batch["indices"][edges] - first == alone["indices"]).all()
                frame += 1
    assert (batch["target"] == np.concatenate([drives[1].target[10:14], drives[0].target[7:9]]).astype("f4")).all()


def test_labels_are_matched_by_frame_number(folder: Path) -> None:
    artefacts.write_labels(folder / f"labels/{NAME}.h5", NAME, np.arange(40) / 100, np.arange(40))
    assert read(folder)[0].target[:, 0] == pytest.approx(np.arange(23) / 100)
    artefacts.write_labels(folder / f"labels/{NAME}.h5", NAME, np.arange(20) / 100, np.arange(20))
    with pytest.raises(InputError, match="no label for frame 20"):
        read(folder)


def test_target_is_the_label_horizon_frames_ahead(folder: Path) -> None:
    steering, valid = np.arange(25) / 100, np.arange(25) != 20
    frame = np.setdiff1d(np.arange(26), [10])  # frame 10 has neither label nor graph
    artefacts.write_labels(folder / f"labels/{NAME}.h5", NAME, steering, frame, valid)
    rng = np.random.default_rng(0)
    artefacts.write_graphs(folder / f"graphs/semantic/{NAME}.h5", NAME, np.zeros(22), frame[:22], 12, rng)
    (drive,) = read_drives(folder / "graphs/semantic", folder / "labels", [NAME], 4, horizon=5)
    ahead = {int(number): row for row, number in enumerate(frame)}
    for row, number in enumerate(drive.frame + 5):
        known = int(number) in ahead
        assert drive.valid[row, 0] == (known and bool(valid[ahead[int(number)]]))
        assert drive.target[row, 0] == pytest.approx(steering[ahead[int(number)]] if known else np.nan, nan_ok=True)
        assert np.isnan(drive.curvature_1pm[row, 0]) != known
    batch = read_batch([drive], windows.Span(0, 0, 10), window=4)  # windows end at frames 3 to 9
    assert batch["target"][:, 0] == pytest.approx([0.08, 0.09, 0.0, 0.10, 0.11, 0.12, 0.13])  # no NaN, but not valid
    assert batch["valid"][:, 0].tolist() == [True, True, False, True, True, True, True]


def test_motion_and_base_of_a_batch(folder: Path) -> None:
    """Not measured in frames 0 and 5: the angle is held, odometry is unknown before the first measurement."""
    moved = ~np.isin(np.arange(23), [0, 5])
    for name in DRIVES:
        with store.DriveReader(folder / f"labels/{name}.h5", stage="labels") as truth:
            artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", truth["steering_rad"], moved)
    without, drives, no_base = read(folder), read(folder, motion="visual"), read(folder, motion="visual", base="none")
    steering = drives[0].target[:, 0]
    held = np.where(moved, steering, np.where(np.arange(23) == 0, 0, steering[4]))
    assert drives[0].base == pytest.approx(held, abs=1e-6)
    assert without[0].odometry[:, 0] == pytest.approx(np.r_[np.nan, held[1:]], abs=1e-6, nan_ok=True)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    batch, plain, unbased = (read_batch(read, *group) for read in (drives, without, no_base))
    assert batch["motion"].shape == (11 + 9, 4)
    assert batch["motion"].dtype == batch["base"].dtype == np.float32
    assert (batch["base"] == batch["motion"][batch["windows"][:, -1], 0]).all()
    assert batch["motion"][11 + 5].tolist() == [pytest.approx(held[4], abs=1e-6), 0, 0, 0]
    assert batch["motion"][11 + 6, 2:].tolist() == [8, 1]
    assert "motion" not in plain
    assert not plain["base"].any()
    assert (unbased["motion"] == batch["motion"]).all()
    assert not unbased["base"].any()


@pytest.mark.parametrize("name", list(DRIVES))
def test_the_control_gets_the_scene_of_another_frame_and_nothing_else_changes(original: Path, name: str) -> None:
    """With 23 frames the scenes are 11 frames later, and continue at the start of the drive."""
    folders = original / "graphs/semantic", original / "labels"
    (drive,), (control,) = (read_drives(*folders, [name], 8, scene=scene) for scene in ("same", "another"))
    with open_graphs(drive.graphs) as graphs:
        for span, moved in zip(windows.spans([drive], 8, 5), windows.spans([control], 8, 5), strict=True):
            batch, other = read_batch([drive], span), read_batch([control], moved)
            rows = ((np.arange(span.start, span.stop) + 11) % 23).tolist()
            frames = [collate([(graphs, row, row + 1)]) for row in rows]
            assert batch.keys() == other.keys()
            for key in ("xyz", "degree"):
                assert (other[key] == np.concatenate([frame[key] for frame in frames])).all()
            assert not np.array_equal(other["xyz"], batch["xyz"])
            for key in ("windows", "dt_s", "base", "target", "valid"):
                assert (other[key] == batch[key]).all()


def test_training_of_the_control_draws_far_scenes_and_leaves_other_random_numbers_alone(original: Path) -> None:
    drives, control = read(original, 4), read(original, 4, scene="another")
    drawn = [windows.random_spans(control, 4, 3, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    shifts = {span.shift for spans in drawn for span in spans}
    assert len(shifts) > 5
    assert min(shifts) >= 5
    assert max(shifts) <= 18
    plain = windows.random_spans(drives, 4, 3, np.random.default_rng(0))
    assert {span.shift for span in plain} == {0}


EDGES_M = [0.0, 5.0, 10.0, 20.0]
TWICE = np.repeat(np.array([2.0, 1.0], np.float32), [10, 9])  # of the frames of two spans


def scaled_batch(folder: Path, predict: str, write: object = artefacts.write_graphs) -> Arrays:
    """Return two spans of ten and nine frames with motion, and three and two windows."""
    artefacts.write_dataset(folder, DRIVES, frames=40, points=40, write=write, ahead_m=EDGES_M)
    for name in DRIVES:
        artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", np.linspace(-0.3, 0.4, 40))
    folders = folder / "graphs/semantic", folder / "labels"
    drives = read_drives(*folders, list(DRIVES), 8, motion="visual", predict=predict)
    return read_batch(drives, windows.Span(0, 0, 10), windows.Span(1, 1, 10))


@pytest.mark.parametrize("write", [artefacts.write_graphs, artefacts.write_sets, artefacts.write_images])
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_a_world_twice_as_large_has_bends_of_twice_the_radius(tmp_path: Path, predict: str, write: object) -> None:
    batch = scaled_batch(tmp_path, predict, write)
    path = predict == "path"
    scaled = reading.rescale(batch, TWICE, EDGES_M if path else ())
    if "image" in batch:  # a larger world gives the same image
        assert all((scaled[key] == batch[key]).all() for key in batch)
        return
    factor = np.where(np.arange(len(batch["xyz"])) < batch["ptr"][10], 2, 1)[:, None]
    assert (scaled["xyz"] == batch["xyz"] * factor).all()
    angle, yaw_rate, speed, valid = scaled["motion"].T.astype(np.float64)
    assert np.tan(angle) == pytest.approx(artefacts.WHEELBASE_M * yaw_rate / speed, rel=1e-5, abs=1e-6)
    assert (speed == batch["motion"][:, 2] * TWICE).all()
    assert (valid == batch["motion"][:, 3]).all()
    curvature = (lambda rad: rad) if path else np.tan
    for name in ("base", "target"):
        now, before = scaled[name].reshape(5, -1)[:, 0], batch[name].reshape(5, -1)[:, 0]
        assert curvature(now) == pytest.approx(curvature(before) / [2, 2, 2, 1, 1], rel=1e-5)
    assert scaled.keys() == batch.keys()


@given(st.floats(0.5, 2.0), st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3))
def test_the_path_in_a_larger_world_has_the_mean_curvature_of_its_stretched_course(
    factor: float, values: list[float]
) -> None:
    curvature = np.array([values])
    path, known = reading.scale_path(curvature, np.ones((1, 3), bool), EDGES_M, np.array([factor]))
    step = (np.arange(20_000) + 0.5) / 1000  # distances in the scaled world, metres
    course = curvature[0, np.clip(np.searchsorted(EDGES_M, step / factor) - 1, 0, 2)] / factor
    for number, (near, far) in enumerate(pairwise(EDGES_M)):
        assert known[0, number] == (far / factor <= EDGES_M[-1] + 1e-3)
        expected = course[(step > near) & (step < far)].mean() if known[0, number] else 0
        assert path[0, number] == pytest.approx(expected, abs=3e-4)


def test_a_range_that_overlaps_an_unknown_one_is_unknown() -> None:
    path, valid = np.full((2, 3), 0.01, np.float32), np.array([[True, True, False], [False, True, True]])
    scaled, known = reading.scale_path(path, valid, EDGES_M, np.array([0.9, 1.25], np.float32))
    assert known.tolist() == [[True, False, False], [False, False, True]]
    np.testing.assert_allclose(scaled, np.where(known, 0.01 / np.array([[0.9], [1.25]]), 0), rtol=1e-6)
