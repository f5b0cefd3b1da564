"""A folder for the toy stage, and the files that one process writes there."""

from pathlib import Path

import pytest

from tests.pipeline.base import toy_stage


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "trouble").mkdir()
    toy_stage.write_inputs(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files that one process writes."""
    folder = tmp_path_factory.mktemp("serial")
    toy_stage.write_inputs(folder)
    toy_stage.main(folder, workers=1)
    return toy_stage.outputs(folder)
