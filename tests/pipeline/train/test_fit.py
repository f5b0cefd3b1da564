from typing import get_args

import numpy as np
import pytest

from pipeline.sections.train import Train
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


def curve(*val_nmse):
    return [fit.Epoch(number, 0.1, 0.1, 0.1, nmse) for number, nmse in enumerate(val_nmse, start=1)]


def test_each_rule_keeps_its_epoch():
    lucky_second = curve(0.9, 0.3, 0.8, 0.5, 0.4, 0.41, 0.7)
    assert fit.kept_epoch(lucky_second, "best") == 2
    assert fit.kept_epoch(lucky_second, "smoothed") == 6
    assert fit.kept_epoch(lucky_second, "last") == 7


def test_patience_counts_epochs_since_the_kept_one():
    rows = curve(0.9, 0.5, 0.6, 0.7)
    assert fit.out_of_patience(rows, "best", patience=2)
    assert not fit.out_of_patience(rows, "best", patience=3)
    assert not fit.out_of_patience(rows, "last", patience=1)


@pytest.mark.parametrize("keep", get_args(Train.model_fields["keep"].annotation))
def test_an_epoch_whose_validation_says_nothing_is_not_the_best(keep):
    nothing = float("nan")
    assert fit.kept_epoch(curve(0.9, 0.8, nothing), keep) == (3 if keep == "last" else 2)
    assert fit.kept_epoch(curve(nothing, nothing), keep) == 2
    assert fit.kept_epoch([], keep) == 0


def test_curve_leaves_empty_what_was_not_measured(tmp_path):
    nothing = float("nan")
    fit.write_curve(tmp_path / "curve.csv", [fit.Epoch(1, 0.003, 0.5, nothing, nothing)])
    assert (tmp_path / "curve.csv").read_text() == (
        "epoch,learning_rate,train_loss,val_mse_rad2,val_nmse\n1,0.003,0.5,,\n"
    )
