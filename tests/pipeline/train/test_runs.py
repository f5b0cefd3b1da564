from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.train import fit, predict, runs
from pipeline.train.curve import Epoch, out_of_patience, selected_epoch

SPLITS = {"a": "train", "x": "test", "b": "train", "v": "val", "y": "test", "z": "test"}


def test_without_folds_the_first_seed_has_the_models_folder() -> None:
    result = runs.runs(Path("data/train/gnn"), [3, 0, 7], runs.folds(SPLITS, "train", None))
    assert [(run.seed, str(run.folder), str(run)) for run in result] == [
        (3, "data/train/gnn", "seed 3"), (0, "data/train/gnn/seed-0", "seed 0"), (7, "data/train/gnn/seed-7", "seed 7"),
    ]  # fmt: skip
    assert {run.fold for run in result} == {runs.Fold(None, ("a", "b"), ("v",), ("x", "y", "z"))}
    assert {runs.model_name(run.folder) for run in result} == {"gnn"}


@pytest.mark.parametrize(("fit_to", "left"), [("others", ()), ("both", ("a", "b"))])
def test_leave_one_out(fit_to: str, left: tuple[str, ...]) -> None:
    folds = runs.folds(SPLITS, fit_to, None)
    assert [fold.name for fold in folds] == ["x", "y", "z"]
    val = ("v",) if fit_to == "both" else ()
    assert folds[1] == runs.Fold("y", (*left, "x", "z"), val, ("y",))
    result = runs.runs(Path("data/train/gnn"), [0, 5], folds)
    assert [str(run.folder) for run in result[2:4]] == ["data/train/gnn/fold-z", "data/train/gnn/seed-5/fold-x"]
    assert str(result[2]) == "seed 0 without z"
    assert len({run.folder for run in result}) == 6
    assert {runs.model_name(run.folder) for run in result} == {"gnn"}


def test_roads_are_the_first_training_drives() -> None:
    assert runs.folds(SPLITS, "train", 1)[0].train == ("a",)
    assert runs.folds(SPLITS, "both", 2)[0].train == ("a", "b", "y", "z")


def epochs(*val_nmse):
    return [Epoch(number, 0.1, 0.1, 0.1, nmse) for number, nmse in enumerate(val_nmse, start=1)]


def test_the_kept_epoch_has_the_least_mean_of_three() -> None:
    lucky_second = epochs(0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7)
    assert selected_epoch(lucky_second) == 6
    assert not out_of_patience(lucky_second, patience=2)
    assert out_of_patience(lucky_second, patience=1)


def test_epochs_without_validation_error_are_not_selected() -> None:
    nothing = float("nan")
    assert selected_epoch(epochs(0.9, 0.8, nothing)) == 2
    assert selected_epoch(epochs(nothing, nothing)) == 2
    assert selected_epoch([]) == 0


def test_targets_of_a_step_are_standardised_weighted_and_mirrored() -> None:
    target = predict.Target(mean_rad=0.0, std_rad=0.5, wheelbase_m=2.7, min_speed_mps=1.0)
    batch = {
        "steering_rad": torch.tensor([0.2, -0.3, 0.0]),
        "base_rad": torch.tensor([0.1, 0.0, 0.0]),
        "valid": torch.tensor([True, True, False]),
    }
    plain = fit.step_targets(batch, target, alpha=2.0, mirror=False, dtype=torch.float64)
    assert plain["residual"].tolist() == pytest.approx([0.2, -0.6, 0.0])
    assert plain["weight"].tolist() == pytest.approx([np.exp(0.4), np.exp(0.6), 0.0])
    both = fit.step_targets(batch, target, alpha=2.0, mirror=True, dtype=torch.float64)
    assert torch.equal(both["residual"], torch.cat([plain["residual"], -plain["residual"]]))
    assert torch.equal(both["weight"], torch.cat([plain["weight"], plain["weight"]]))


def test_robust_loss_with_uncertainty_learns_the_path_as_before() -> None:
    predicted = torch.tensor([[0.5, 0.1, -1.0, 0.3], [9.0, 0.2, 0.0, 0.5]], requires_grad=True)
    target, weight = torch.tensor([[0.2, 0.4], [0.0, 0.3]]), torch.tensor([[2.0, 1.0], [1.0, 0.0]])
    plain = fit.robust_loss(predicted[:, :2], target, weight)
    loss = fit.robust_loss(predicted, target, weight)
    ratio = (predicted[:, :2] - target).abs() / predicted[:, 2:].exp()
    huber = torch.where(ratio < 1, ratio.square() / 2, ratio - 0.5)
    assert loss.item() == pytest.approx((plain + (weight * (predicted[:, 2:] + huber)).sum()).item())
    (alone,), (both,) = (torch.autograd.grad(value, predicted, retain_graph=True) for value in (plain, loss))
    assert torch.equal(alone[:, :2], both[:, :2])
    assert both[0, 2:].all()


def test_loss_with_uncertainty_is_the_likelihood_of_a_normal_distribution() -> None:
    predicted = torch.tensor([[0.5, -1.0], [0.1, 0.3], [9.0, 0.0]], requires_grad=True)
    target, weight = torch.tensor([0.2, 0.4, 0.0]), torch.tensor([2.0, 1.0, 0.0])
    each = torch.distributions.Normal(predicted[:, 0], predicted[:, 1].exp()).log_prob(target)
    constant = 3 * np.log(2 * np.pi) / 2
    squared = fit.weighted_loss(predicted[:, 0], target, weight)
    loss = fit.weighted_loss(predicted, target, weight)
    assert loss.item() == pytest.approx(squared.item() - (weight @ each).item() - constant)
    (plain,), (gradient,) = (torch.autograd.grad(value, predicted, retain_graph=True) for value in (squared, loss))
    assert gradient[:, 0].tolist() == plain[:, 0].tolist()
