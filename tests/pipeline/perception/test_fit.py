from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.perception.examples import Examples
from pipeline.perception.fit import EpochLoss, depth_and_class_loss, fit
from pipeline.train import checkpoint
from tests import street

DRIVE = "2026_01_01_drive_0001"
Fitted = tuple[nn.Module, list[EpochLoss]]


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Examples]:
    folder = tmp_path_factory.mktemp("ingest")
    street.write_drive(folder, DRIVE, 6)
    with Examples(folder, [DRIVE], 6) as examples:
        yield examples


def run(examples: Examples, state_path: Path, epochs: int = 4, frozen: bool = False, **other: float) -> Fitted:
    torch.manual_seed(0)
    model = UnifiedEncoder("small")
    model.backbone.requires_grad_(not frozen)
    settings = {"learning_rate": 0.003, "seed": 0, **other}
    curve = fit(model, examples, epochs=epochs, batch=3, state_path=state_path, **settings)
    return model, curve


@pytest.fixture(scope="module")
def fitted(examples: Examples, tmp_path_factory: pytest.TempPathFactory) -> Fitted:
    return run(examples, tmp_path_factory.mktemp("fit") / "kept.pt")


def test_a_fit_lowers_both_losses(fitted: Fitted) -> None:
    _, curve = fitted
    assert curve[-1].depth < 0.9 * curve[0].depth
    assert curve[-1].classes < 0.9 * curve[0].classes
    assert [row.epoch for row in curve] == [1, 2, 3, 4]


def test_an_interrupted_fit_resumes_to_the_same_weights(
    examples: Examples, fitted: Fitted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = checkpoint.write

    def kill_after_two(path: Path, content: dict[str, Any]) -> None:
        write(path, content)
        if len(content["curve"]) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", kill_after_two)
        with pytest.raises(KeyboardInterrupt):
            run(examples, tmp_path / "kept.pt")
    resumed, curve = run(examples, tmp_path / "kept.pt")
    model, uninterrupted = fitted
    assert curve == uninterrupted
    for name, tensor in model.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


def test_the_loss_ignores_unknown_pixels_and_matches_hand_values() -> None:
    depth = torch.tensor([[[2.0, 8.0, 5.0]]])
    true_depth = torch.tensor([[[4.0, 8.0, 0.0]]])
    logits = torch.zeros(1, 19, 1, 3)
    logits[0, 3, 0, 0] = 50.0
    true_cls = torch.tensor([[[3, 255, 7]]])
    loss = depth_and_class_loss(depth, logits, true_depth, true_cls)
    np.testing.assert_allclose(loss, [(np.log(2) / 2 + 0.5 / 2) / 2, np.log(19) / 2], rtol=1e-5)
