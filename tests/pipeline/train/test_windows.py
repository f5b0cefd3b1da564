import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch.utils.data import DataLoader

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.graphs.graph_file import collate, open_graphs
from pipeline.labels import label
from pipeline.settings.models import Entry
from pipeline.train import windows
from pipeline.train.labelled_drive import LabelledDrive, Timeline, consecutive, read_drives
from tests import artefacts
from tests.pipeline.train.shared import DRIVES

BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


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


def _read(folder: Path, window: int = 8) -> list[LabelledDrive]:
    return read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), window)


def test_the_dataset_of_the_documentation(original: Path) -> None:
    """It yields each window once, in a form that a network of this project reads."""
    (code,) = (block for block in BLOCK.findall((ROOT / "docs/models.md").read_text()) if "class Windows" in block)
    names: dict[str, Any] = {}
    exec(code, names)
    dataset = names["Windows"](original / "graphs/semantic", original / "labels", list(DRIVES))
    batches = list(DataLoader(dataset, batch_size=None))
    assert len(batches) == len(dataset) == 2 * (23 - 7)
    net = Entry.model_validate({"input": "semantic", "spatial": "gnn", "temporal": "lstm", "semantics": 0.0}).build(
        "graph"
    )
    for batch in batches:
        assert batch["ptr"].shape == (9,)
        assert batch["dt_s"].shape == (1, 8)
        assert batch["steering_rad"].shape == batch["valid"].shape == (1,)
        assert net(*net.inputs(batch)).isfinite().all()


def test_consecutive_frames_end_at_a_gap() -> None:
    assert consecutive(np.array([3, 4, 5, 9, 10, 12])) == ((0, 3), (3, 5), (5, 6))
    assert consecutive(np.array([7])) == ((0, 1),)
    assert consecutive(np.array([], int)) == ()


def test_spans_cover_each_window_once(original: Path) -> None:
    drives = _read(original)
    random = [windows.random_spans(drives, 8, 5, np.random.default_rng(seed)) for seed in range(20)]
    for spans in (windows.spans(drives, 8, 5), *random):
        ends = [(span.drive, row) for span in spans for row in range(span.start + 7, span.stop)]
        assert sorted(ends) == [(number, row) for number in range(2) for row in range(7, 23)]
        assert all(span.stop - span.start - 7 <= 5 for span in spans)


def test_spans_for_some_frames_have_only_frames_of_their_windows(original: Path) -> None:
    drives = _read(original)
    near, far = np.array([9, 11, 8]), np.array([22, 2])  # row 2: too early
    spans = windows.spans(drives, 4, 100, [near, far])
    assert [(span.drive, span.start, span.stop) for span in spans] == [(0, 5, 12), (1, 19, 23)]
    apart = windows.spans(drives[:1], 4, 100, [np.array([4, 9])])  # rows 1-4 and 6-9
    assert [(span.start, span.stop) for span in apart] == [(1, 5), (6, 10)]
    every = [np.arange(23)] * 2
    assert windows.spans(drives, 4, 5, every) == windows.spans(drives, 4, 5)
    assert [span.stop - span.start for span in windows.spans(drives[:1], 1, 10)] == [10, 10, 3]


def test_batch_of_two_spans_equals_single_frames(original: Path) -> None:
    drives = _read(original)
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


def test_labels_are_matched_by_frame_number(folder: Path) -> None:
    drive = next(iter(DRIVES))
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(40) / 100, np.arange(40))
    assert _read(folder)[0].steering_rad == pytest.approx(np.arange(23) / 100)
    artefacts.write_labels(folder / f"labels/{drive}.h5", drive, np.arange(20) / 100, np.arange(20))
    with pytest.raises(InputError, match="no label for frame 20"):
        _read(folder)


def test_target_is_the_label_horizon_frames_ahead(folder: Path) -> None:
    name = next(iter(DRIVES))
    steering, valid = np.arange(25) / 100, np.arange(25) != 20
    frame = np.setdiff1d(np.arange(26), [10])  # frame 10 has neither label nor graph
    artefacts.write_labels(folder / f"labels/{name}.h5", name, steering, frame, valid)
    rng = np.random.default_rng(0)
    artefacts.write_graphs(folder / f"graphs/semantic/{name}.h5", name, np.zeros(22), frame[:22], 12, rng)
    (drive,) = read_drives(folder / "graphs/semantic", folder / "labels", [name], 4, horizon=5)
    assert drive.frame.tolist() == frame[:22].tolist()
    ahead = {int(number): row for row, number in enumerate(frame)}
    for row, number in enumerate(drive.frame + 5):
        known = int(number) in ahead
        assert drive.valid[row] == (known and bool(valid[ahead[int(number)]]))
        assert drive.steering_rad[row] == pytest.approx(steering[ahead[int(number)]] if known else np.nan, nan_ok=True)
        assert np.isnan(drive.curvature_1pm[row]) != known
    (batch,) = windows.batches([drive], [[windows.Span(0, 0, 10)]], 4)  # windows end at frames 3 to 9
    assert batch["steering_rad"] == pytest.approx([0.08, 0.09, 0.0, 0.10, 0.11, 0.12, 0.13])  # no NaN, but not valid
    assert batch["valid"].tolist() == [True, True, False, True, True, True, True]


def test_motion_and_base_angle_of_a_batch(folder: Path) -> None:
    for name in DRIVES:
        with store.DriveReader(folder / f"labels/{name}.h5", stage="labels") as truth:
            moved = np.arange(23) != 5
            artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", truth["steering_rad"], moved)
    without = _read(folder)
    drives = read_drives(folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, motion="visual")
    held = np.where(moved, drives[0].steering_rad, drives[0].steering_rad[4])
    assert drives[0].base_rad == pytest.approx(held, abs=1e-6)
    assert drives[0].measured_rad["visual"] is not None
    assert without[0].measured_rad["visual"] == pytest.approx(drives[0].base_rad)
    group = [windows.Span(1, 3, 14), windows.Span(0, 0, 9)]
    (batch,), (plain,) = windows.batches(drives, [group], 8), windows.batches(without, [group], 8)
    assert batch["motion"].shape == (11 + 9, 4)
    assert batch["motion"].dtype == batch["base_rad"].dtype == np.float32
    assert (batch["base_rad"] == batch["motion"][batch["windows"][:, -1], 0]).all()
    assert batch["base_rad"] == pytest.approx(np.r_[drives[1].base_rad[10:14], drives[0].base_rad[7:9]])
    assert batch["motion"][11 + 5].tolist() == [pytest.approx(held[4], abs=1e-6), 0, 0, 0]
    assert batch["motion"][11 + 6, 2:].tolist() == [8, 1]
    assert "motion" not in plain
    assert not plain["base_rad"].any()
    without_base = read_drives(
        folder / "graphs/semantic", folder / "labels", list(DRIVES), 8, motion="visual", base="none"
    )
    (batch_without_base,) = windows.batches(without_base, [group], 8)
    assert (batch_without_base["motion"] == batch["motion"]).all()
    assert not batch_without_base["base_rad"].any()


@pytest.mark.parametrize("base", ["motion", "none"])
def test_a_stream_has_the_windows_of_the_file(folder: Path, base: str) -> None:
    """With a gap, motion that is not measured, and an angle that is held over more than a window."""
    name = next(iter(DRIVES))
    frame = np.setdiff1d(np.arange(23), [4])
    valid = (np.arange(22) > 2) & (np.arange(22) < 7)
    rng = np.random.default_rng(0)
    artefacts.write_graphs(folder / f"graphs/semantic/{name}.h5", name, np.zeros(22), frame, 12, rng)
    artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", np.linspace(-0.3, 0.2, 22), valid)
    with open_graphs(folder / f"graphs/semantic/{name}.h5") as graphs:
        car, motion = label.Car(artefacts.WHEELBASE_M, 1.0), graphs.motion
        assert motion
        timeline = Timeline.read(graphs, "visual", car, base)
        stream, ends = windows.Stream(3, car, base), []
        for row, number in enumerate(graphs.frame.tolist()):
            measured = (float(motion.yaw_rate_radps[row]), float(motion.speed_mps[row])) if valid[row] else None
            if arrays := stream.add(number, float(graphs.time_s[row]), measured):
                ends.append(row)
                span = windows.Span(0, row - 2, row + 1)
                (expected,) = windows.batches([timeline], [[span]], 3, {0: graphs})
                assert all(np.array_equal(arrays[key], expected[key]) for key in arrays)
                assert {"windows", "dt_s", "base_rad", "motion"} == arrays.keys()
    assert ends == [2, 3, *range(6, 22)]
    assert (timeline.base_rad[-1] != 0) == (base == "motion")


@pytest.mark.parametrize("name", list(DRIVES))
def test_the_control_gets_the_scene_of_another_frame_and_nothing_else_changes(original: Path, name: str) -> None:
    """With 23 frames the scenes are 11 frames later, and continue at the start of the drive."""
    folders = original / "graphs/semantic", original / "labels"
    (drive,), (control,) = (read_drives(*folders, [name], 8, scene=scene) for scene in ("same", "another"))
    spans, shifted = windows.spans([drive], 8, 5), windows.spans([control], 8, 5)
    assert [(span.start, span.stop) for span in spans] == [(span.start, span.stop) for span in shifted]
    with open_graphs(drive.graphs) as graphs:
        for span, moved in zip(spans, shifted, strict=True):
            (batch,), (other,) = windows.batches([drive], [[span]], 8), windows.batches([control], [[moved]], 8)
            rows = ((np.arange(span.start, span.stop) + 11) % 23).tolist()
            frames = [collate([(graphs, row, row + 1)]) for row in rows]
            assert batch.keys() == other.keys()
            assert (other["xyz"] == np.concatenate([frame["xyz"] for frame in frames])).all()
            assert not np.array_equal(other["xyz"], batch["xyz"])
            degree = np.concatenate([frame["degree"] for frame in frames])
            assert (other["degree"] == degree).all()
            for key in ("windows", "dt_s", "base_rad", "steering_rad", "valid"):
                assert (other[key] == batch[key]).all()


def test_training_of_the_control_draws_far_scenes_and_leaves_other_random_numbers_alone(original: Path) -> None:
    folders = original / "graphs/semantic", original / "labels"
    drives, control = (read_drives(*folders, list(DRIVES), 4, scene=scene) for scene in ("same", "another"))
    drawn = [windows.random_spans(control, 4, 3, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    shifts = {span.shift for spans in drawn for span in spans}
    assert len(shifts) > 5
    assert min(shifts) >= 5
    assert max(shifts) <= 18
    assert {span.shift for span in windows.random_spans(drives, 4, 3, np.random.default_rng(0))} == {0}
