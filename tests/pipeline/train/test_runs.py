from pathlib import Path

import pytest

from pipeline.train import runs

PLAIN = {"fit_to": "train", "roads": None}
SPLITS = {"a": "train", "x": "test", "b": "train", "v": "val", "y": "test", "z": "test"}


def test_without_folds_the_first_seed_has_the_models_folder() -> None:
    result = runs.runs(Path("data/train/gnn"), [3, 0, 7], runs.folds(SPLITS, PLAIN))
    assert [(run.seed, str(run.folder), str(run)) for run in result] == [
        (3, "data/train/gnn", "seed 3"), (0, "data/train/gnn/seed-0", "seed 0"), (7, "data/train/gnn/seed-7", "seed 7"),
    ]  # fmt: skip
    assert {run.fold for run in result} == {runs.Fold(None, ("a", "b"), ("v",), ("x", "y", "z"))}
    assert {runs.model_name(run.folder) for run in result} == {"gnn"}


@pytest.mark.parametrize(("fit_to", "left"), [("others", ()), ("both", ("a", "b"))])
def test_leave_one_out(fit_to: str, left: tuple[str, ...]) -> None:
    folds = runs.folds(SPLITS, PLAIN | {"fit_to": fit_to})
    assert [fold.name for fold in folds] == ["x", "y", "z"]
    val = ("v",) if fit_to == "both" else ()
    assert folds[1] == runs.Fold("y", (*left, "x", "z"), val, ("y",))
    result = runs.runs(Path("data/train/gnn"), [0, 5], folds)
    assert [str(run.folder) for run in result[2:4]] == ["data/train/gnn/fold-z", "data/train/gnn/seed-5/fold-x"]
    assert str(result[2]) == "seed 0 without z"
    assert len({run.folder for run in result}) == 6
    assert {runs.model_name(run.folder) for run in result} == {"gnn"}


def test_roads_are_the_first_training_drives() -> None:
    assert runs.folds(SPLITS, PLAIN | {"roads": 1})[0].train == ("a",)
    assert runs.folds(SPLITS, PLAIN | {"roads": 2, "fit_to": "both"})[0].train == ("a", "b", "y", "z")
