from pathlib import Path

import numpy as np
import pytest

from models.steering.core.batch import GraphBatch, from_arrays
from pipeline.camera import classes
from pipeline.sections.train import Noise
from pipeline.train import augment, windows
from tests import artefacts
from tests.pipeline.train.shared import DRIVES, read_batch

FRAMES = [12, 11]
ALL = Noise(depth_scale=0.3, depth_waves=0.1, speed=0.2, confused=0.5, missing=0.3, dropped=0.4, hidden_deg=30)


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> windows.Batch:
    return make(tmp_path_factory.mktemp("noise"))


def make(folder: Path, write: object = artefacts.write_graphs) -> windows.Batch:
    artefacts.write_dataset(folder, DRIVES, frames=12, points=50, write=write)
    return read_batch(folder, [windows.Span(0, 0, 12), windows.Span(1, 1, 12)])


def noisy(batch: windows.Batch, settings: Noise, seed: int = 0) -> windows.Batch:
    return augment.add_noise(batch, FRAMES, [np.random.default_rng([seed, run]) for run in (1, 2)], settings)


def differing(a: windows.Batch, b: windows.Batch) -> set[str]:
    return {key for key in a if a[key].shape != b[key].shape or (a[key] != b[key]).any()}


def test_depth_scale_is_constant_over_a_run(batch: windows.Batch) -> None:
    after = noisy(batch, Noise(depth_scale=0.3))
    factors = []
    for start, stop in ((0, 12), (12, 23)):
        points = slice(batch["ptr"][start], batch["ptr"][stop])
        factor = after["xyz"][points.start, 2] / batch["xyz"][points.start, 2]
        assert after["xyz"][points] == pytest.approx(batch["xyz"][points] * factor, rel=1e-5)
        factors.append(float(factor))
    assert 1 / 1.3 <= min(factors) < max(factors) <= 1.3
    assert after["motion"] == pytest.approx(batch["motion"], rel=1e-6)


def test_waves_move_points_along_their_rays(batch: windows.Batch) -> None:
    after = noisy(batch, Noise(depth_waves=0.2))
    assert differing(batch, after) <= {"xyz", "motion", "base_rad"}  # these but for rounding
    assert after["motion"] == pytest.approx(batch["motion"], rel=1e-6)
    factor = np.linalg.norm(after["xyz"], axis=1) / np.linalg.norm(batch["xyz"], axis=1)
    assert after["xyz"] == pytest.approx(batch["xyz"] * factor[:, None], rel=1e-5, abs=1e-5)
    assert np.abs(factor - 1).max() <= 0.2 + 1e-5
    assert factor.std() > 0.01
    close = np.repeat(factor, batch["degree"]) - factor[batch["indices"]]
    assert np.abs(close).mean() < factor.std() / 2


def test_classes_become_similar_ones_or_void(batch: windows.Batch) -> None:
    found = set()
    for seed in range(12):
        confused = noisy(batch, Noise(confused=0.5), seed)["cls"]
        missing = noisy(batch, Noise(missing=0.5), seed)["cls"]
        pairs = set(zip(batch["cls"].tolist(), confused.tolist(), strict=True))
        assert all(now == was or now in augment.CONFUSED_WITH[was] for was, now in pairs)
        found |= pairs
        gone = missing != batch["cls"]
        assert (missing[gone] == classes.VOID).all()
        first = np.arange(len(gone)) < batch["ptr"][12]
        for run in (first, ~first):
            assert all(len(set(gone[run & (batch["cls"] == number)])) == 1 for number in set(batch["cls"]))
    assert {(classes.ROAD, classes.SIDEWALK), (classes.BUILDING, classes.WALL)} < found
    assert set(augment.CONFUSED_WITH) == set(range(classes.COUNT)) - {classes.SKY}


def test_removed_points_take_their_edges_with_them(batch: windows.Batch) -> None:
    after = noisy(batch, Noise(dropped=0.6, hidden_deg=40))
    nodes = len(after["xyz"])
    assert 0.3 * len(batch["xyz"]) < nodes < len(batch["xyz"])
    assert after["ptr"][-1] == nodes == len(after["cls"]) == len(after["degree"])
    assert after["degree"].sum() == len(after["indices"])
    assert (np.diff(after["ptr"]) > 0).all()
    # Reference: edge by edge, by position.
    place = {tuple(point): row for row, point in enumerate(after["xyz"].tolist())}
    assert len(place) == nodes
    rows = np.repeat(np.arange(len(batch["xyz"])), batch["degree"])
    xyz = [tuple(point) for point in noisy(batch, Noise(depth_waves=1e-30))["xyz"].tolist()]  # rounded as `after`
    wanted = [
        (place[xyz[a]], place[xyz[b]])
        for a, b in zip(rows, batch["indices"], strict=True)
        if xyz[a] in place and xyz[b] in place
    ]
    assert list(zip(np.repeat(np.arange(nodes), after["degree"]), after["indices"], strict=True)) == wanted
    assert isinstance(from_arrays(after), GraphBatch)
