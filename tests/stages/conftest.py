"""Five drives with small graphs, for the stages that train and evaluate."""

import shutil
from pathlib import Path

import pytest

from tests import artefacts
from tests.small_model import EDGES_M, SPLITS, write_params


@pytest.fixture(scope="session")
def dataset(tmp_path_factory) -> Path:
    """Write small graphs and labels with the path ahead; motion begins with the second frame."""
    folder = tmp_path_factory.mktemp("dataset")
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80, ahead_m=EDGES_M, motion=True)
    return folder


@pytest.fixture
def folder(dataset, tmp_path) -> Path:
    shutil.copytree(dataset, tmp_path / "data")
    write_params(tmp_path / "data")
    return tmp_path / "data"
