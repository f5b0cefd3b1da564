from pathlib import Path
from typing import Any

import pytest

from pipeline.base.errors import InputError
from pipeline.train import runs

SPLITS = {"a": "train", "x": "test", "b": "train", "v": "val", "y": "test", "z": "test"}


def test_without_folds_the_first_seed_is_the_model_and_each_folder_knows_its_name() -> None:
    made = runs.runs(Path("data/train/gnn"), [3, 0, 7], runs.folds(SPLITS, {}))
    assert [(run.seed, str(run.folder), str(run)) for run in made] == [
        (3, "data/train/gnn", "seed 3"), (0, "data/train/gnn/seed-0", "seed 0"), (7, "data/train/gnn/seed-7", "seed 7"),
    ]  # fmt: skip
    assert {run.fold for run in made} == {runs.Fold(None, ("a", "b"), ("v",), ("x", "y", "z"))}
    assert {runs.model_name(run.folder) for run in made} == {"gnn"}


@pytest.mark.parametrize(("fit_to", "left"), [("others", ()), ("both", ("a", "b"))])
def test_a_fold_for_each_test_drive_which_it_does_not_see(fit_to: str, left: tuple[str, ...]) -> None:
    folds = runs.folds(SPLITS, {"fit_to": fit_to})
    assert [fold.name for fold in folds] == ["x", "y", "z"]
    val = ("v",) if fit_to == "both" else ()  # validation is of training's world
    assert folds[1] == runs.Fold("y", (*left, "x", "z"), val, ("y",))
    made = runs.runs(Path("data/train/gnn"), [0, 5], folds)
    assert [str(run.folder) for run in made[2:4]] == ["data/train/gnn/fold-z", "data/train/gnn/seed-5/fold-x"]
    assert str(made[2]) == "seed 0 without z"
    assert len({run.folder for run in made}) == 6
    assert {runs.model_name(run.folder) for run in made} == {"gnn"}


def test_roads_are_the_first_training_drives() -> None:
    assert runs.folds(SPLITS, {"roads": 1})[0].train == ("a",)
    assert runs.folds(SPLITS, {"roads": 2, "fit_to": "both"})[0].train == ("a", "b", "y", "z")


@pytest.mark.parametrize(
    ("line", "splits", "message"),
    [
        ({"roads": 3}, SPLITS, "^roads = 3: there are 2 training drives"),
        ({"fit_to": "others"}, {"a": "train", "x": "test"}, "^fit_to = 'others': x is the only test drive"),
    ],
)
def test_folds_that_cannot_be(line: dict[str, Any], splits: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        runs.folds(splits, line)


def test_the_name_is_that_of_the_folder_however_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gnn").mkdir()
    monkeypatch.chdir(tmp_path / "gnn")
    assert runs.model_name(Path()) == "gnn"
