from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.fitting.prefetch import prefetch
from pipeline.train import frames, windows
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=40)
    return tmp_path


def _read(folder: Path, window: int = 8) -> list[windows.Drive]:
    return windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), window)


def test_consecutive_frames_end_at_a_gap() -> None:
    assert windows.consecutive(np.array([3, 4, 5, 9, 10, 12])) == ((0, 3), (3, 5), (5, 6))
    assert windows.consecutive(np.array([7])) == ((0, 1),)
    assert windows.consecutive(np.array([], int)) == ()


def test_spans_hold_each_window_once_whatever_the_phase(folder: Path) -> None:
    drives = _read(folder)
    random = [windows.random_spans(drives, 8, 5, np.random.default_rng(seed)) for seed in range(20)]
    for spans in (windows.spans(drives, 8, 5), *random):
        ends = [(span.drive, row) for span in spans for row in range(span.start + 7, span.stop)]
        assert sorted(ends) == [(number, row) for number in range(2) for row in range(7, 23)]
        assert all(span.stop - span.start - 7 <= 5 for span in spans)


def test_spans_for_some_frames_hold_what_their_windows_need_and_share(folder: Path) -> None:
    drives = _read(folder)
    near, far = np.array([9, 11, 8]), np.array([22, 2])  # no window ends at row 2
    spans = windows.spans(drives, 4, 100, [near, far])
    assert [(span.drive, span.start, span.stop) for span in spans] == [(0, 5, 12), (1, 19, 23)]
    apart = windows.spans(drives[:1], 4, 100, [np.array([4, 9])])  # windows of rows 1-4 and 6-9 share nothing
    assert [(span.start, span.stop) for span in apart] == [(1, 5), (6, 10)]
    every = [np.arange(23)] * 2
    assert windows.spans(drives, 4, 5, every) == windows.spans(drives, 4, 5)
    assert [span.stop - span.start for span in windows.spans(drives[:1], 1, 10)] == [10, 10, 3]


def test_random_spans_without_a_target_are_left_out(folder: Path) -> None:
    drive = _read(folder)[0]
    drive.valid[:15] = False
    for seed in range(5):
        spans = windows.random_spans([drive], 8, 5, np.random.default_rng(seed))
        assert spans
        assert all(drive.valid[span.start + 7 : span.stop].any() for span in spans)


def test_rows_of_frames_are_by_number(folder: Path) -> None:
    drive = _read(folder)[0]
    frame, three = np.array([3, 4, 9]), slice(3)
    later = replace(drive, frame=frame, time_s=drive.time_s[three], dt_s=drive.dt_s[three], runs=((0, 2), (2, 3)))
    assert later.rows_of([9, 3, 9]).tolist() == [2, 0, 2]
    assert later.rows_of([]).tolist() == []
    with pytest.raises(InputError, match=r"drive_0001\.h5 has no frame 5\b.*3 to 9"):
        later.rows_of([4, 5, 6])


def test_random_spans_differ_between_epochs_and_repeat_by_seed(folder: Path) -> None:
    drives = _read(folder)
    first, again, other = (windows.random_spans(drives, 8, 5, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again != other


def test_drives_without_any_point_teach_nothing(folder: Path) -> None:
    rng = np.random.default_rng(0)
    first, second = (folder / f"graphs/semantic/{name}.h5" for name in DRIVES)
    artefacts.write_graphs(first, first.stem, np.full(23, 0.1), np.arange(23), 0, rng)
    assert [drive.empty for drive in _read(folder)] == [True, False]
    artefacts.write_graphs(second, second.stem, np.full(23, 0.1), np.arange(23), 0, rng)
    with pytest.raises(InputError, match=r"semantic: no point in any frame of .*_0001, .*_0002: widen .* crop_m"):
        _read(folder)
    artefacts.write_graphs(second, second.stem, np.full(7, 0.1), np.arange(7), 40, rng)
    with pytest.raises(InputError, match="no window of 8 consecutive frames"):  # that holds a point
        _read(folder)


def test_runs_shorter_than_a_window_give_no_span(folder: Path) -> None:
    gaps = replace(_read(folder)[0], runs=((0, 5), (5, 13), (13, 23)))
    spans = windows.spans([gaps], 8, 100)
    assert [(span.start, span.stop) for span in spans] == [(5, 13), (13, 23)]


def test_batch_of_two_spans_equals_the_frames_one_by_one(folder: Path) -> None:
    drives = _read(folder)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    (batch,) = windows.examples(drives, [group], 8)
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
    assert drive.dt_s[0] == np.float32(0.1)  # KITTI's synced stream: 10 Hz


def test_a_window_longer_than_any_run_is_an_error(folder: Path) -> None:
    with pytest.raises(InputError, match=r"no window of 24 consecutive frames .*longest run: 23"):
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
    with pytest.raises(InputError, match=r"every valid label .* is 0"):
        _read(folder)


def test_labels_are_matched_by_frame_number(folder: Path) -> None:
    drive = next(iter(DRIVES))
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(40) / 100, np.arange(40))
    assert _read(folder)[0].steering_rad == pytest.approx(np.arange(23) / 100)
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(20) / 100, np.arange(20))
    with pytest.raises(InputError, match="no label for frame 20"):
        _read(folder)


def test_the_target_is_the_label_so_many_frames_ahead(folder: Path) -> None:
    name = next(iter(DRIVES))
    steering, valid = np.arange(25) / 100, np.arange(25) != 20
    frame = np.setdiff1d(np.arange(26), [10])  # of frame 10 there is no label, nor a graph
    artefacts.write_labels(folder / f"labels/{name}.h5", name, steering, frame, valid)
    rng = np.random.default_rng(0)
    artefacts.write_graphs(folder / f"graphs/semantic/{name}.h5", name, np.zeros(22), frame[:22], 12, rng)
    (drive,) = windows.read_drives(folder / "graphs/semantic", folder / "labels", [name], 4, horizon=5)
    assert drive.frame.tolist() == frame[:22].tolist()
    ahead = {int(number): row for row, number in enumerate(frame)}
    for row, number in enumerate(drive.frame + 5):
        known = int(number) in ahead
        assert drive.valid[row] == (known and bool(valid[ahead[int(number)]]))
        assert drive.steering_rad[row] == pytest.approx(steering[ahead[int(number)]] if known else np.nan, nan_ok=True)
        assert np.isnan(drive.curvature_1pm[row]) != known
    (batch,) = windows.examples([drive], [[windows.Span(0, 0, 10)]], 4)  # windows end at frames 3 to 9
    assert batch["steering_rad"] == pytest.approx([0.08, 0.09, 0.0, 0.10, 0.11, 0.12, 0.13])  # no NaN, but not valid
    assert batch["valid"].tolist() == [True, True, False, True, True, True, True]


def test_persistence_knows_the_last_valid_label_and_its_own_only_ahead_of_time(folder: Path) -> None:
    name = next(iter(DRIVES))
    artefacts.write_labels(folder / f"labels/{name}.h5", name, np.arange(30) / 10, np.arange(30), np.arange(30) != 1)
    for horizon, expected in ((0, [0.0, 0.0, 0.0, 0.2, 0.3]), (2, [0.0, 0.0, 0.2, 0.3, 0.4])):
        (drive,) = windows.read_drives(folder / "graphs/semantic", folder / "labels", [name], 4, horizon)
        assert drive.held_rad[:5] == pytest.approx(expected)


def test_frames_too_near_the_end_have_no_target(folder: Path) -> None:
    assert len(windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, 15)) == 2
    with pytest.raises(InputError, match=r"no window of 8 .* with a valid label 16 frames after its end"):
        windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, 16)


def test_motion_stands_in_the_batch_and_is_what_the_answer_adds_to(folder: Path) -> None:
    for name in DRIVES:
        with store.DriveReader(folder / f"labels/{name}.h5", stage="labels") as truth:
            moved = np.arange(23) != 5
            artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", "visual", truth["steering_rad"], moved)
    without = _read(folder)
    drives = windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, 0, "visual")
    held = np.where(moved, drives[0].steering_rad, drives[0].steering_rad[4])
    assert drives[0].base_rad == pytest.approx(held, abs=1e-6)
    assert drives[0].measured_rad["visual"] is not None
    assert without[0].measured_rad["visual"] == pytest.approx(drives[0].base_rad)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    (batch,), (plain,) = windows.examples(drives, [group], 8), windows.examples(without, [group], 8)
    assert batch["motion"].shape == (11 + 9, len(windows.MOTION))
    assert batch["motion"].dtype == batch["base_rad"].dtype == np.float32
    assert (batch["base_rad"] == batch["motion"][batch["windows"][:, -1], 0]).all()
    assert batch["base_rad"] == pytest.approx(np.r_[drives[1].base_rad[10:14], drives[0].base_rad[7:9]])
    assert batch["motion"][11 + 5].tolist() == [pytest.approx(held[4], abs=1e-6), 0, 0, 0]
    assert batch["motion"][11 + 6, 2:].tolist() == [8, 1]
    assert "motion" not in plain
    assert not plain["base_rad"].any()


def test_motion_that_the_file_does_not_carry_is_named(folder: Path) -> None:
    with pytest.raises(InputError, match=r"drive_0001\.h5 carries no motion: lidar"):
        windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, 0, "lidar")


def test_motion_that_is_measured_in_no_frame_says_nothing(folder: Path) -> None:
    first, second = DRIVES
    artefacts.add_motion(folder / f"graphs/semantic/{first}.h5", "lidar", np.full(23, 0.1))
    artefacts.add_motion(folder / f"graphs/semantic/{second}.h5", "lidar", np.full(23, 0.1), np.zeros(23))
    measured = [drive.measured_rad["lidar"] for drive in _read(folder)]
    assert measured[0] == pytest.approx(np.full(23, 0.1), abs=1e-6)
    assert np.isnan(measured[1]).all()
    with pytest.raises(InputError, match=rf"{second}\.h5: motion: lidar is measured in no frame .* leave {second} out"):
        windows.read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, 0, "lidar")


def test_batches_read_ahead_in_a_thread_are_the_same(folder: Path) -> None:
    drives = _read(folder)
    groups = [[span] for span in windows.spans(drives, 8, 5)]
    pairs = list(zip(windows.examples(drives, groups, 8), prefetch(windows.examples(drives, groups, 8)), strict=True))
    assert len(pairs) == len(groups) > 3
    for direct, ahead in pairs:
        assert direct.keys() == ahead.keys()
        assert all(direct[name].tobytes() == ahead[name].tobytes() for name in direct)


def test_open_files_are_read_as_closed_ones_and_stay_open(folder: Path) -> None:
    drives = _read(folder)
    groups = [[windows.Span(0, 0, 9), windows.Span(1, 2, 12)]]
    (alone,) = windows.batches(drives, groups, 8)
    with frames.open_graphs(drives[1].graphs) as graphs:
        (shared,) = windows.batches(drives, groups, 8, {1: graphs})
        assert len(graphs.read(0, 1)["ptr"]) == 2
    assert alone.keys() == shared.keys()
    assert not {"steering_rad", "valid"} & alone.keys()
    assert all((alone[name] == shared[name]).all() for name in alone)
