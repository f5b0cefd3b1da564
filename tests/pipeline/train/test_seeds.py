from pathlib import Path

import pytest

from pipeline.train import seeds


def test_the_first_seed_is_the_model_and_each_folder_knows_its_name() -> None:
    folders = seeds.folders(Path("data/train/gnn"), [3, 0, 7])
    assert folders == {
        3: Path("data/train/gnn"), 0: Path("data/train/gnn/seed-0"), 7: Path("data/train/gnn/seed-7")
    }  # fmt: skip
    assert {seeds.model_name(folder) for folder in folders.values()} == {"gnn"}


def test_the_name_is_that_of_the_folder_however_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gnn").mkdir()
    monkeypatch.chdir(tmp_path / "gnn")
    assert seeds.model_name(Path()) == "gnn"
