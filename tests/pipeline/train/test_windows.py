from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.fitting.prefetch import prefetch
from pipeline.train import windows
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=40)
    return tmp_path


def _read(folder: Path, length: int = 8) -> list[windows.Drive]:
    return windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), length)


def test_consecutive_frames_end_at_a_gap() -> None:
    assert windows.consecutive(np.array([3, 4, 5, 9, 10, 12])) == ((0, 3), (3, 5), (5, 6))
    assert windows.consecutive(np.array([7])) == ((0, 1),)
    assert windows.consecutive(np.array([], int)) == ()


def test_spans_hold_each_window_once_whatever_the_phase(folder: Path) -> None:
    drives = _read(folder)
    for rng in (None, *(np.random.default_rng(seed) for seed in range(20))):
        ends = [(s.drive, row) for s in windows.spans(drives, 8, 5, rng) for row in range(s.start + 7, s.stop)]
        assert sorted(ends) == [(number, row) for number in range(2) for row in range(7, 23)]
        assert all(s.stop - s.start - 7 <= 5 for s in windows.spans(drives, 8, 5, rng))


def test_random_spans_differ_between_epochs_and_repeat_by_seed(folder: Path) -> None:
    drives = _read(folder)
    first, again, other = (windows.spans(drives, 8, 5, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other


def test_runs_shorter_than_a_window_give_no_span(folder: Path) -> None:
    drive = _read(folder)[0]
    gaps = windows.Drive(**{**vars(drive), "runs": ((0, 5), (5, 13), (13, 23))})
    spans = windows.spans([gaps], 8, 100)
    assert [(span.start, span.stop) for span in spans] == [(5, 13), (13, 23)]


def test_batch_of_two_spans_equals_the_frames_one_by_one(folder: Path) -> None:
    drives = _read(folder)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    (batch,) = windows.batches(drives, [group], 8)
    assert batch["windows"].shape == batch["dt_s"].shape == (4 + 2, 8)
    frame = 0
    for span in group:
        with store.DriveReader(drives[span.drive].graphs, stage="graphs") as file:
            for row in range(span.start, span.stop):
                a, b = file["ptr"][row : row + 2]
                e, f = file["indices_ptr"][row : row + 2]
                first, last = batch["ptr"][frame : frame + 2]
                assert (batch["xyz"][first:last] == file["xyz"][a:b]).all()
                assert (batch["degree"][first:last] == file["degree"][a:b]).all()
                edges = slice(*np.concatenate([[0], np.cumsum(batch["degree"], dtype=np.int64)])[[first, last]])
                assert (batch["indices"][edges] - first == file["indices"][e:f]).all()
                frame += 1
    assert (batch["windows"][3] == np.arange(3, 11)).all()
    assert (batch["windows"][4] == np.arange(11, 19)).all()
    expected = np.concatenate([drives[1].steering_rad[10:14], drives[0].steering_rad[7:9]])
    assert batch["steering_rad"] == pytest.approx(expected)


def test_time_step_is_that_of_the_frame_before_and_nominal_after_a_gap(folder: Path) -> None:
    drive = _read(folder)[0]
    assert drive.dt_s == pytest.approx(np.full(23, 0.1), rel=1e-5)
    assert drive.dt_s[0] == np.float32(windows.NOMINAL_DT_S)


def test_mirror_reflects_chosen_frames_and_twice_is_nothing(folder: Path) -> None:
    drives = _read(folder)
    (batch,) = windows.batches(drives, [[windows.Span(0, 0, 10), windows.Span(1, 0, 9)]], 8)
    chosen = np.repeat([True, False], [10, 9])
    mirrored = windows.mirror(batch, chosen)
    points = batch["ptr"][10]
    assert (mirrored["xyz"][:points] == batch["xyz"][:points] * [-1, 1, 1]).all()
    assert (mirrored["xyz"][points:] == batch["xyz"][points:]).all()
    assert (mirrored["steering_rad"] == batch["steering_rad"] * [-1, -1, -1, 1, 1]).all()
    back = windows.mirror(mirrored, chosen)
    assert all((back[key] == batch[key]).all() for key in batch)


def test_a_window_longer_than_any_run_is_an_error(folder: Path) -> None:
    with pytest.raises(
        InputError, match=r"no window of 24 consecutive frames .* \(longest run: 23 frames\): use a smaller"
    ):
        _read(folder, 24)
    assert len(_read(folder, 23)) == 2


def test_a_split_without_valid_targets_is_an_error(folder: Path) -> None:
    for drive in DRIVES:
        steering = np.zeros(23)
        artefacts.write_labels(folder / f"labels/{drive}.h5", drive, steering, np.arange(23), np.arange(23) < 7)
    with pytest.raises(InputError, match="with a valid label at its end"):
        _read(folder)


def test_drives_whose_labels_are_all_zero_are_an_error(folder: Path) -> None:
    for drive in DRIVES:
        artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.zeros(23), np.arange(23))
    with pytest.raises(InputError, match=r"every valid label of .* is 0, nothing to learn or judge"):
        _read(folder)


def test_labels_are_matched_by_frame_number(folder: Path) -> None:
    drive = next(iter(DRIVES))
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(40) / 100, np.arange(40))
    assert _read(folder)[0].steering_rad == pytest.approx(np.arange(23) / 100)
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(20) / 100, np.arange(20))
    with pytest.raises(InputError, match="no label for frame 20"):
        _read(folder)


def test_a_world_twice_as_large_bends_half_as_much(folder: Path) -> None:
    drives = _read(folder)
    (batch,) = windows.batches(drives, [[windows.Span(0, 0, 10), windows.Span(1, 0, 9)]], 8)
    scaled = windows.rescale(batch, np.repeat(np.array([2.0, 1.0], np.float32), [10, 9]))
    points = batch["ptr"][10]
    assert (scaled["xyz"][:points] == 2 * batch["xyz"][:points]).all()
    assert (scaled["xyz"][points:] == batch["xyz"][points:]).all()
    assert np.tan(scaled["steering_rad"]) == pytest.approx(np.tan(batch["steering_rad"]) / [2, 2, 2, 1, 1], rel=1e-6)


def test_images_are_mirrored_left_right_and_know_no_scale(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=12, write=artefacts.write_images)
    (batch,) = windows.batches(_read(tmp_path), [[windows.Span(0, 0, 10), windows.Span(1, 1, 10)]], 8)
    chosen = np.repeat([True, False], [10, 9])
    mirrored = windows.mirror(batch, chosen)
    assert (mirrored["image"][:10] == batch["image"][:10, :, ::-1]).all()
    assert (mirrored["image"][10:] == batch["image"][10:]).all()
    assert (mirrored["steering_rad"] == batch["steering_rad"] * [-1, -1, -1, 1, 1]).all()
    # A larger world gives the same image, so the image cannot tell of wider bends.
    scaled = windows.rescale(batch, np.full(19, 2, np.float32))
    assert all((scaled[key] == batch[key]).all() for key in batch)


def test_neighbourhoods_stay_in_mirrored_and_rescaled_worlds(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=12, write=artefacts.write_sets)
    (batch,) = windows.batches(_read(tmp_path), [[windows.Span(0, 0, 10)]], 8)
    for changed, factor in (
        (windows.mirror(batch, np.full(10, True)), [-1, 1, 1]),
        (windows.rescale(batch, np.full(10, 2, np.float32)), 2),
    ):
        assert (changed["xyz"] == batch["xyz"] * factor).all()
        assert all((changed[key] == batch[key]).all() for key in batch if key not in ("xyz", "steering_rad"))


def test_batches_read_ahead_in_a_thread_are_the_same(folder: Path) -> None:
    drives = _read(folder)
    groups = [[span] for span in windows.spans(drives, 8, 5)]
    pairs = list(zip(windows.batches(drives, groups, 8), prefetch(windows.batches(drives, groups, 8)), strict=True))
    assert len(pairs) == len(groups) > 3
    for direct, ahead in pairs:
        assert direct.keys() == ahead.keys()
        assert all(direct[name].tobytes() == ahead[name].tobytes() for name in direct)
