"""Five drives with small graphs, for the stages that train and evaluate."""

import shutil
from pathlib import Path

import pytest

from tests import artefacts
from tests.small_model import SPLITS, write_params


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset")
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80)
    return folder


@pytest.fixture
def folder(dataset: Path, tmp_path: Path) -> Path:
    shutil.copytree(dataset, tmp_path / "data")
    write_params(tmp_path / "data")
    return tmp_path / "data"
