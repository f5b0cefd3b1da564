from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pipeline.graphs.graph_file import Arrays
from pipeline.train import augment, windows
from pipeline.train.labelled_drive import read_drives
from tests import artefacts
from tests.pipeline.train.shared import DRIVES, read_batch

PARAMS = Path(__file__).resolve().parents[3] / "params.yaml"
FRAMES = [10, 9]  # of the two spans, with three and two windows
TWICE = np.repeat(np.array([2.0, 1.0], np.float32), FRAMES)


@pytest.fixture(scope="module", params=["graphs", "sets", "images"])
def batch(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    """Two spans of ten and nine frames with motion, of each kind of input."""
    folder = tmp_path_factory.mktemp("augment")
    write = {"graphs": artefacts.write_graphs, "sets": artefacts.write_sets, "images": artefacts.write_images}
    artefacts.write_dataset(folder, DRIVES, frames=12, points=40, write=write[request.param])
    return read_batch(folder, [windows.Span(0, 0, 10), windows.Span(1, 1, 10)])


def test_a_world_twice_as_large_has_bends_of_twice_the_radius(batch: Arrays) -> None:
    scaled = augment.rescale(batch, TWICE)
    if "image" in batch:  # a larger world gives the same image
        assert all((scaled[key] == batch[key]).all() for key in batch)
        return
    factor = np.where(np.arange(len(batch["xyz"])) < batch["ptr"][10], 2, 1)[:, None]
    assert (scaled["xyz"] == batch["xyz"] * factor).all()
    assert np.tan(scaled["steering_rad"]) == pytest.approx(np.tan(batch["steering_rad"]) / [2, 2, 2, 1, 1], rel=1e-6)
    angle, yaw_rate, speed, valid = scaled["motion"].T.astype(np.float64)
    assert np.tan(angle) == pytest.approx(artefacts.WHEELBASE_M * yaw_rate / speed, rel=1e-5, abs=1e-6)
    assert (speed == batch["motion"][:, 2] * TWICE).all()
    assert (valid == batch["motion"][:, 3]).all()
    assert (scaled["base_rad"] == scaled["motion"][batch["windows"][:, -1], 0]).all()


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25, 2.0])
def test_the_path_in_a_larger_world_has_the_mean_curvature_of_its_stretched_course(factor: float) -> None:
    edges, curvature = [0.0, 5.0, 10.0, 20.0, 30.0], np.array([[0.02, -0.01, 0.05, 0.1]], np.float32)
    path, known = augment.scale_path(curvature, np.ones((1, 4), bool), edges, np.array([factor], np.float32))
    assert path.dtype == np.float32
    step = (np.arange(30_000) + 0.5) / 1000  # distances in the scaled world, metres
    course = curvature[0, np.clip(np.searchsorted(edges, step / factor) - 1, 0, 3)] / factor
    for number, (near, far) in enumerate(pairwise(edges)):
        assert known[0, number] == (far / factor <= edges[-1])
        expected = course[(step > near) & (step < far)].mean() if known[0, number] else 0
        assert path[0, number] == pytest.approx(expected, abs=2e-5)


def test_a_range_that_overlaps_an_unknown_one_is_unknown() -> None:
    path, valid = np.full((2, 3), 0.01, np.float32), np.array([[True, True, False], [False, True, True]])
    scaled, known = augment.scale_path(path, valid, [0, 5, 10, 20], np.array([0.9, 1.25], np.float32))
    assert known.tolist() == [[True, False, False], [False, False, True]]
    np.testing.assert_allclose(scaled, np.where(known, 0.01 / np.array([[0.9], [1.25]]), 0), rtol=1e-6)


def test_a_path_in_a_batch_is_scaled_with_its_scene(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=40, points=12, ahead_m=[0, 5, 10])
    drives = read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(DRIVES), 4, predict="path")
    (batch,) = windows.batches(drives, [[windows.Span(0, 0, 20)]], 4)
    scaled = augment.rescale(batch, np.full(20, 1.25, np.float32), drives[0].ahead_m)
    assert (scaled["xyz"] == batch["xyz"] * np.float32(1.25)).all()
    both = batch["valid"][:, 0] & scaled["valid"][:, 0]
    assert both.any()
    np.testing.assert_allclose(scaled["path_1pm"][both, 0], batch["path_1pm"][both, 0] / 1.25, rtol=1e-5)
    assert set(scaled) == set(batch)
