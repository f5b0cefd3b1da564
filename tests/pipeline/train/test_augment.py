from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.graphs.graph_file import Arrays
from pipeline.train import augment, windows
from pipeline.train.labelled_drive import read_drives
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
EDGES_M = [0.0, 5.0, 10.0, 20.0]
TWICE = np.repeat(np.array([2.0, 1.0], np.float32), [10, 9])  # of the frames of two spans


def read_batch(folder: Path, predict: str, write: object = artefacts.write_graphs) -> Arrays:
    """Return two spans of ten and nine frames with motion, and three and two windows."""
    artefacts.write_dataset(folder, DRIVES, frames=40, points=40, write=write, ahead_m=EDGES_M)
    for name in DRIVES:
        artefacts.add_motion(folder / f"graphs/semantic/{name}.h5", np.linspace(-0.3, 0.4, 40))
    folders = folder / "graphs/semantic", folder / "labels"
    drives = read_drives(*folders, list(DRIVES), 8, motion="visual", predict=predict)
    (batch,) = windows.batches(drives, [[windows.Span(0, 0, 10), windows.Span(1, 1, 10)]], 8)
    return batch


@pytest.mark.parametrize("write", [artefacts.write_graphs, artefacts.write_sets, artefacts.write_images])
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_a_world_twice_as_large_has_bends_of_twice_the_radius(tmp_path: Path, predict: str, write: object) -> None:
    batch = read_batch(tmp_path, predict, write)
    path = predict == "path"
    scaled = augment.rescale(batch, TWICE, EDGES_M if path else ())
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
    path, known = augment.scale_path(curvature, np.ones((1, 3), bool), EDGES_M, np.array([factor]))
    step = (np.arange(20_000) + 0.5) / 1000  # distances in the scaled world, metres
    course = curvature[0, np.clip(np.searchsorted(EDGES_M, step / factor) - 1, 0, 2)] / factor
    for number, (near, far) in enumerate(pairwise(EDGES_M)):
        assert known[0, number] == (far / factor <= EDGES_M[-1] + 1e-3)
        expected = course[(step > near) & (step < far)].mean() if known[0, number] else 0
        assert path[0, number] == pytest.approx(expected, abs=3e-4)


def test_a_range_that_overlaps_an_unknown_one_is_unknown() -> None:
    path, valid = np.full((2, 3), 0.01, np.float32), np.array([[True, True, False], [False, True, True]])
    scaled, known = augment.scale_path(path, valid, EDGES_M, np.array([0.9, 1.25], np.float32))
    assert known.tolist() == [[True, False, False], [False, False, True]]
    np.testing.assert_allclose(scaled, np.where(known, 0.01 / np.array([[0.9], [1.25]]), 0), rtol=1e-6)
