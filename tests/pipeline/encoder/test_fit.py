from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.encoder.examples import Examples
from pipeline.encoder.fit import EpochLoss, depth_and_class_loss, fit
from pipeline.fitting import checkpoint
from tests import street

DRIVE = "2026_01_01_drive_0001"


@pytest.fixture
def examples(tmp_path: Path) -> Examples:
    street.write_drive(tmp_path, DRIVE, 12)
    return Examples(tmp_path, [DRIVE], 12)


def _fit(examples: Examples, kept: Path, epochs: int = 3, **other: float) -> tuple[nn.Module, list[EpochLoss]]:
    torch.manual_seed(0)
    model = UnifiedEncoder("small")
    curve = fit(model, examples, epochs=epochs, batch=5, **{"learning_rate": 0.003, "seed": 0, "kept": kept, **other})
    return model, curve


def test_fitting_lowers_both_losses(examples: Examples, tmp_path: Path) -> None:
    _, curve = _fit(examples, tmp_path / "kept.pt", epochs=8)
    assert curve[-1].depth < 0.8 * curve[0].depth
    assert curve[-1].classes < 0.8 * curve[0].classes
    assert [row.epoch for row in curve] == list(range(1, 9))


def test_same_seed_same_weights_and_a_killed_run_goes_on_to_the_same(
    examples: Examples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, curve = _fit(examples, tmp_path / "a.pt")
    again, _ = _fit(examples, tmp_path / "b.pt")

    write = checkpoint.write

    def kill_after_two(path: Path, content: dict[str, Any]) -> None:
        write(path, content)
        if len(content["curve"]) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", kill_after_two)
        with pytest.raises(KeyboardInterrupt):
            _fit(examples, tmp_path / "c.pt")
    resumed, resumed_curve = _fit(examples, tmp_path / "c.pt")

    assert resumed_curve == curve
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name]), name
        assert torch.equal(tensor, resumed.state_dict()[name]), name


def test_other_seed_other_weights(examples: Examples, tmp_path: Path) -> None:
    _, first = _fit(examples, tmp_path / "a.pt", epochs=1)
    _, second = _fit(examples, tmp_path / "b.pt", epochs=1, seed=1)
    assert first != second


def test_a_frozen_backbone_stays(examples: Examples, tmp_path: Path) -> None:
    model = UnifiedEncoder("small")
    model.backbone.requires_grad_(False)
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    fit(model, examples, epochs=1, batch=6, learning_rate=0.01, seed=0, kept=tmp_path / "kept.pt")
    for name, tensor in model.state_dict().items():  # batch statistics are in it too
        assert torch.equal(tensor, before[name]) == name.startswith("backbone."), name


def test_a_diverged_fit_names_the_learning_rate(examples: Examples, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no longer finite in epoch \d+: lower encoder.learning_rate"):
        _fit(examples, tmp_path / "kept.pt", learning_rate=1e30)


def test_loss_ignores_what_is_unknown_and_matches_hand_values() -> None:
    depth = torch.tensor([[[2.0, 8.0, 5.0]]])
    true_depth = torch.tensor([[[4.0, 8.0, 0.0]]])
    logits = torch.zeros(1, 19, 1, 3)
    logits[0, 3, 0, 0] = 50.0
    true_cls = torch.tensor([[[3, 255, 7]]])
    loss = depth_and_class_loss(depth, logits, true_depth, true_cls)
    np.testing.assert_allclose(loss, [(np.log(2) / 2 + 0.5 / 2) / 2, np.log(19) / 2], rtol=1e-5)


def test_loss_is_zero_and_differentiable_without_any_truth() -> None:
    depth, logits = torch.ones(1, 2, 2, requires_grad=True), torch.zeros(1, 19, 2, 2, requires_grad=True)
    loss = depth_and_class_loss(depth, logits, torch.zeros(1, 2, 2), torch.full((1, 2, 2), 255))
    loss.sum().backward()
    assert loss.tolist() == [0, 0]
    assert depth.grad is not None
    assert not depth.grad.any()
