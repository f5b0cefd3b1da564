from pathlib import Path

import numpy as np
import pytest

from pipeline.graphs.graph_file import Arrays
from pipeline.train import augment, windows
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
