from pathlib import Path

import pytest
from tests.pipeline.test_score_card import metrics

from pipeline.base import store
from pipeline.base.errors import InputError
from stages import report


def run(folder: Path) -> str:
    (folder / "params.yaml").write_text("models: {lonely: {}}")
    report.main(folder / "evaluate", folder / "report", folder / "params.yaml", folder / "perception")
    return (folder / "report/table.md").read_text()


def test_what_depth_is_worth_stands_below_the_models_where_it_is_known(tmp_path: Path) -> None:
    without = run(tmp_path)
    store.write_json(tmp_path / "perception/metrics.json", metrics())
    assert "lonely is not evaluated on this machine" in without
    assert "flat ground" not in without
    assert run(tmp_path).startswith(without + "\n| depth of | truth |")


def test_damaged_metrics_are_one_error(tmp_path: Path) -> None:
    (tmp_path / "perception").mkdir()
    (tmp_path / "perception/metrics.json").write_text("{")
    with pytest.raises(InputError, match="dvc repro --force perception"):
        run(tmp_path)
