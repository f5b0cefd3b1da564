import numpy as np
import pytest

from pipeline.train import fit, windows
from tests import artefacts


@pytest.fixture
def drives(tmp_path):
    splits = {"2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train"}
    artefacts.write_dataset(tmp_path, splits, frames=23, points=20)
    return windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", list(splits), 8)


def test_equal_weights_count_every_valid_frame(drives):
    drives[0].valid[:5] = False
    assert fit.effective_frames(drives, 0.0) == pytest.approx(2 * 23 - 5)


def test_a_large_alpha_leaves_the_loss_to_a_few_frames(drives):
    weight = np.exp(20 * np.abs(np.concatenate([drive.steering_rad for drive in drives])))
    counts = [fit.effective_frames(drives, alpha) for alpha in (0.0, 5.0, 20.0, 100_000.0)]
    assert counts[2] == pytest.approx(weight.sum() ** 2 / (weight**2).sum())
    assert counts == sorted(counts, reverse=True)
    assert counts[3] == pytest.approx(1, abs=0.1)  # the sharpest bend alone, without overflow
