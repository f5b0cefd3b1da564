from pathlib import Path

import numpy as np
import pytest

from models.steering.core.batch import GraphBatch
from pipeline.camera import classes
from pipeline.sections.train import Noise
from pipeline.train import noise, windows
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
FRAMES = [12, 11]
ALL = Noise(depth_scale=0.3, depth_waves=0.1, speed=0.2, confused=0.5, missing=0.3, dropped=0.4, hidden_deg=30)


def make(tmp_path: Path, write: object = artefacts.write_graphs) -> windows.Batch:
    artefacts.write_dataset(tmp_path, DRIVES, frames=12, points=50, write=write)
    for name in DRIVES:
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", "visual", np.linspace(-0.3, 0.4, 12))
    drives = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(DRIVES), 8, motion="visual")
    (batch,) = windows.examples(drives, [[windows.Span(0, 0, 12), windows.Span(1, 1, 12)]], 8)
    return batch


@pytest.fixture
def batch(tmp_path: Path) -> windows.Batch:
    return make(tmp_path)


def disturbed(batch: windows.Batch, settings: Noise, seed: int = 0) -> windows.Batch:
    return noise.disturbed(batch, FRAMES, [np.random.default_rng([seed, run]) for run in (1, 2)], settings)


def differing(a: windows.Batch, b: windows.Batch) -> set[str]:
    return {key for key in a if a[key].shape != b[key].shape or (a[key] != b[key]).any()}


def test_switched_off_it_changes_nothing(batch: windows.Batch) -> None:
    assert disturbed(batch, Noise()) is batch


def test_neither_labels_nor_the_given_batch_change(batch: windows.Batch) -> None:
    before = {key: value.copy() for key, value in batch.items()}
    for seed in range(5):
        after = disturbed(batch, ALL, seed)
        assert not differing(before, batch)
        assert not {"steering_rad", "valid", "windows", "dt_s"} & differing(before, after)
        assert {key: value.dtype for key, value in after.items()} == {key: each.dtype for key, each in batch.items()}


def test_a_wrong_scale_is_one_of_a_whole_run(batch: windows.Batch) -> None:
    after = disturbed(batch, Noise(depth_scale=0.3))
    factors = []
    for start, stop in ((0, 12), (12, 23)):
        points = slice(batch["ptr"][start], batch["ptr"][stop])
        factor = after["xyz"][points.start, 2] / batch["xyz"][points.start, 2]
        assert after["xyz"][points] == pytest.approx(batch["xyz"][points] * factor, rel=1e-5)
        factors.append(float(factor))
    assert 1 / 1.3 <= min(factors) < max(factors) <= 1.3
    assert after["motion"] == pytest.approx(batch["motion"], rel=1e-6)


def test_so_is_a_wrong_speed_and_the_measured_angle_is_wrong_with_it(batch: windows.Batch) -> None:
    after = disturbed(batch, Noise(speed=0.3))
    factor = after["motion"][:, 2] / batch["motion"][:, 2]
    assert 1 / 1.3 <= factor.min() < factor.max() <= 1.3
    assert factor == pytest.approx(np.repeat(factor[[0, 12]], FRAMES))
    assert np.tan(after["motion"][:, 0]) == pytest.approx(np.tan(batch["motion"][:, 0]) / factor, rel=1e-4)
    assert (after["motion"][:, [1, 3]] == batch["motion"][:, [1, 3]]).all()
    assert (after["base_rad"] == after["motion"][after["windows"][:, -1], 0]).all()
    assert (after["xyz"] == batch["xyz"]).all()


def test_waves_move_points_along_their_rays_neighbours_alike(batch: windows.Batch) -> None:
    after = disturbed(batch, Noise(depth_waves=0.2))
    assert differing(batch, after) <= {"xyz", "motion", "base_rad"}  # these but for rounding
    assert after["motion"] == pytest.approx(batch["motion"], rel=1e-6)
    factor = np.linalg.norm(after["xyz"], axis=1) / np.linalg.norm(batch["xyz"], axis=1)
    assert after["xyz"] == pytest.approx(batch["xyz"] * factor[:, None], rel=1e-5, abs=1e-5)
    assert np.abs(factor - 1).max() <= 0.2 + 1e-5
    assert factor.std() > 0.01
    close = np.repeat(factor, batch["degree"]) - factor[batch["indices"]]
    assert np.abs(close).mean() < factor.std() / 2


def test_some_classes_are_taken_for_similar_ones_and_some_not_seen(batch: windows.Batch) -> None:
    seen = set()
    for seed in range(20):
        confused = disturbed(batch, Noise(confused=0.5), seed)["cls"]
        missing = disturbed(batch, Noise(missing=0.5), seed)["cls"]
        pairs = set(zip(batch["cls"].tolist(), confused.tolist(), strict=True))
        assert all(now == was or now in noise.TAKEN_FOR[was] for was, now in pairs)
        seen |= pairs
        gone = missing != batch["cls"]
        assert (missing[gone] == classes.VOID).all()
        first = np.arange(len(gone)) < batch["ptr"][12]
        for run in (first, ~first):
            assert all(len(set(gone[run & (batch["cls"] == number)])) == 1 for number in set(batch["cls"]))
    assert {(classes.ROAD, classes.SIDEWALK), (classes.BUILDING, classes.WALL)} < seen
    assert set(noise.TAKEN_FOR) == set(range(classes.COUNT)) - {classes.SKY}


def test_dropped_points_leave_their_graph_whole(batch: windows.Batch) -> None:
    after = disturbed(batch, Noise(dropped=0.6, hidden_deg=40))
    nodes = len(after["xyz"])
    assert 0.3 * len(batch["xyz"]) < nodes < len(batch["xyz"])
    assert after["ptr"][-1] == nodes == len(after["cls"]) == len(after["degree"])
    assert after["degree"].sum() == len(after["indices"])
    assert (np.diff(after["ptr"]) > 0).all()
    # The slow way, edge by edge, by where the points lie.
    place = {tuple(point): row for row, point in enumerate(after["xyz"].tolist())}
    assert len(place) == nodes
    rows = np.repeat(np.arange(len(batch["xyz"])), batch["degree"])
    xyz = [tuple(point) for point in disturbed(batch, Noise(depth_waves=1e-30))["xyz"].tolist()]  # rounds as `after`
    wanted = [
        (place[xyz[a]], place[xyz[b]])
        for a, b in zip(rows, batch["indices"], strict=True)
        if xyz[a] in place and xyz[b] in place
    ]
    assert list(zip(np.repeat(np.arange(nodes), after["degree"]), after["indices"], strict=True)) == wanted
    assert GraphBatch.of_arrays(after).frames == 23


def test_runs_do_not_depend_on_those_beside_them(batch: windows.Batch) -> None:
    whole = disturbed(batch, ALL)
    alone = noise.disturbed(
        {
            "xyz": batch["xyz"][: batch["ptr"][12]], "cls": batch["cls"][: batch["ptr"][12]], "ptr": batch["ptr"][:13],
            "degree": batch["degree"][: batch["ptr"][12]],
            "indices": batch["indices"][: batch["degree"][: batch["ptr"][12]].sum(dtype=int)],
            "motion": batch["motion"][:12], "windows": batch["windows"][:5], "steering_rad": batch["steering_rad"][:5],
            "base_rad": batch["base_rad"][:5],
        },
        FRAMES[:1], [np.random.default_rng([0, 1])], ALL,
    )  # fmt: skip
    assert all((whole[key][: len(alone[key])] == alone[key]).all() for key in alone)


def test_sets_keep_all_points_and_images_all(tmp_path: Path) -> None:
    sets = make(tmp_path / "sets", artefacts.write_sets)
    after = disturbed(sets, ALL)
    assert differing(sets, after) == {"xyz", "cls", "motion", "base_rad"}
    images = make(tmp_path / "images", artefacts.write_images)
    assert disturbed(images, ALL) is images
