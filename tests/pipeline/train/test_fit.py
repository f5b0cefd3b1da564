from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.train import fit, windows
from tests import artefacts
from tests.pipeline.train.shared import DRIVES


def test_effective_frames(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, DRIVES, frames=23, points=20)
    drives = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(DRIVES), 8)
    weight = np.exp(20 * np.abs(np.concatenate([drive.steering_rad for drive in drives])))
    counts = [fit.effective_frames(drives, alpha) for alpha in (0.0, 5.0, 20.0, 100_000.0)]
    assert counts[2] == pytest.approx(weight.sum() ** 2 / (weight**2).sum())
    assert counts == sorted(counts, reverse=True)
    assert counts[3] == pytest.approx(1, abs=0.1)  # the sharpest bend alone, without overflow
    drives[0].valid[:5] = False
    assert fit.effective_frames(drives, 0.0) == pytest.approx(2 * 23 - 5)


def test_loss_with_uncertainty_is_the_likelihood_of_a_normal_distribution() -> None:
    predicted = torch.tensor([[0.5, -1.0], [0.1, 0.3], [9.0, 0.0]], requires_grad=True)
    target, weight = torch.tensor([0.2, 0.4, 0.0]), torch.tensor([2.0, 1.0, 0.0])
    each = torch.distributions.Normal(predicted[:, 0], predicted[:, 1].exp()).log_prob(target)
    constant = 3 * np.log(2 * np.pi) / 2
    assert fit.weighted_loss(predicted, target, weight).item() == pytest.approx(-(weight @ each).item() - constant)
