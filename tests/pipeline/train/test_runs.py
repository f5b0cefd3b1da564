from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.train import runs
from pipeline.train.curve import Epoch, out_of_patience, selected_epoch

SPLITS = {"a": "train", "x": "test", "b": "train", "v": "val", "y": "test", "z": "test"}
NOTHING = float("nan")


def test_without_folds_the_first_seed_has_the_models_folder() -> None:
    result = runs.runs(Path("data/train/gnn"), [3, 0], runs.folds(SPLITS, "train", None))
    assert [(run.seed, str(run.folder), str(run)) for run in result] == [
        (3, "data/train/gnn", "seed 3"),
        (0, "data/train/gnn/seed-0", "seed 0"),
    ]
    assert {run.fold for run in result} == {runs.Fold(None, ("a", "b"), ("v",), ("x", "y", "z"))}


@pytest.mark.parametrize(("fit_to", "left"), [("others", ()), ("both", ("a", "b"))])
def test_leave_one_out(fit_to: str, left: tuple[str, ...]) -> None:
    folds = runs.folds(SPLITS, fit_to, None)
    assert [fold.name for fold in folds] == ["x", "y", "z"]
    val = ("v",) if fit_to == "both" else ()
    assert folds[1] == runs.Fold("y", (*left, "x", "z"), val, ("y",))
    result = runs.runs(Path("data/train/gnn"), [0, 5], folds)
    assert [str(run.folder) for run in result[2:4]] == ["data/train/gnn/fold-z", "data/train/gnn/seed-5/fold-x"]
    assert str(result[2]) == "seed 0 without z"


def test_roads_are_the_first_training_drives() -> None:
    assert runs.folds(SPLITS, "train", 1)[0].train == ("a",)
    assert runs.folds(SPLITS, "both", 2)[0].train == ("a", "b", "y", "z")
    with pytest.raises(InputError, match="2 training drives"):
        runs.folds(SPLITS, "train", 3)
    with pytest.raises(InputError, match="two test drives"):
        runs.folds({"a": "test"}, "others", None)


@pytest.mark.parametrize(
    ("nmse", "selected", "patience"),
    [
        ((0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7), 6, 1),  # the least mean of three, not the lucky second
        ((0.9, 0.8, NOTHING), 2, 1),
        ((NOTHING, NOTHING), 2, 0),  # without validation the last
        ((), 0, 0),
    ],
)
def test_the_kept_epoch(nmse: tuple[float, ...], selected: int, patience: int) -> None:
    curve = [Epoch(number, 0.1, 0.1, error) for number, error in enumerate(nmse, start=1)]
    assert selected_epoch(curve) == selected
    assert out_of_patience(curve, patience)
    assert not out_of_patience(curve, patience + 1)
