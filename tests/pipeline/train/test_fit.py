from pathlib import Path

import numpy as np
import pytest

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
