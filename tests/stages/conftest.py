"""Five drives with small graphs, for the stages that train and evaluate."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.store import DriveReader
from tests import artefacts
from tests.small_model import EDGES_M, SPLITS, write_params


@pytest.fixture(scope="session")
def dataset(tmp_path_factory) -> Path:
    """Small graphs with motion that is measured from the second frame on, and labels with the path ahead."""
    folder = tmp_path_factory.mktemp("dataset")
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80, ahead_m=EDGES_M)
    for drive in SPLITS:
        with DriveReader(folder / f"labels/{drive}.h5", stage="labels") as truth:
            graphs, steering_rad = folder / f"graphs/semantic/{drive}.h5", truth["steering_rad"]
        artefacts.add_motion(graphs, steering_rad, np.arange(60) > 0)
    return folder


@pytest.fixture
def folder(dataset, tmp_path) -> Path:
    shutil.copytree(dataset, tmp_path / "data")
    write_params(tmp_path / "data")
    return tmp_path / "data"
