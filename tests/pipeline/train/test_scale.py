"""Scale of outputs, loss and calibration: one column for the angle, one per range for the path."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.train import fit
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.scale import WITHIN, Prediction, Scale, nmse
from tests import artefacts

NAMES = ["2026_01_01_drive_0001", "2026_01_01_drive_0002"]
READING = {"angle": {"horizon": 5}, "path": {"predict": "path"}}
COLUMNS = {"angle": ["steering_rad"], "path": ["path_0-5m_1pm", "path_5-10m_1pm"]}
LOSS = {False: lambda x: x.square(), True: lambda x: torch.where(x.abs() < 1, x.square() / 2, x.abs() - 0.5)}


@pytest.fixture(params=["angle", "path"])
def drives(request: pytest.FixtureRequest, tmp_path: Path) -> list[LabelledDrive]:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "train"), frames=40, points=12, ahead_m=[0, 5, 10])
    for name, scale in zip(NAMES, (0.2, -0.3), strict=True):
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", scale * np.sin(np.arange(40) / 5))
    folders = tmp_path / "graphs/semantic", tmp_path / "labels"
    read = read_drives(*folders, NAMES, 4, motion="visual", **READING[request.param])
    assert read[0].columns == COLUMNS[request.param]
    return read


def test_scale_is_the_regression_and_spread_of_the_residual(drives: list[LabelledDrive]) -> None:
    scale, path = Scale.from_drives(drives), bool(drives[0].ahead_m)
    truth, base = np.concatenate([d.truth for d in drives]), np.concatenate([d.base for d in drives])
    for number in range(len(scale.names)):
        known = np.isfinite(truth[:, number])
        assert 0 < known.sum() < len(truth)
        y, x = truth[known, number], base[known]
        (best,), *_ = np.linalg.lstsq(x[:, None], y, rcond=None)
        assert scale.odometry_gain[number] == pytest.approx(best)
        assert scale.gain[number] == (pytest.approx(best) if path else 1)
        assert scale.std[number] == pytest.approx(np.std(y - scale.gain[number] * x))
        assert scale.mean[number] == pytest.approx(y.mean())
    assert vars(Scale.parse(scale.content)).keys() == scale.content.keys()


@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_encode_and_decode_are_inverse(columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain, std, mean = rng.normal(size=columns), rng.uniform(1e-3, 2, columns), np.zeros(columns)
    scale = Scale.parse(Scale([f"c{n}" for n in range(columns)], gain, std, mean).content)
    y, base, log_sigma = rng.normal(size=(5, columns)), rng.normal(size=5), rng.normal(size=(5, columns))
    decoded = scale.decode(np.concatenate([scale.encode(y, base), log_sigma], axis=1), base)
    np.testing.assert_allclose(decoded.mean, y)
    np.testing.assert_allclose(decoded.sigma, std * np.exp(log_sigma))
    assert scale.encode(y.astype(np.float32), base.astype(np.float32)).dtype == np.float32
    assert scale.decode(np.zeros((5, columns)), base).sigma is None


def test_nmse_is_1_for_zero_and_ignores_unknown_frames(drives: list[LabelledDrive]) -> None:
    for factor, expected in ((0.0, 1.0), (0.5, 0.25)):
        predicted = [Prediction(np.where(d.frame[:, None] < 4, np.nan, factor * d.target)) for d in drives]
        assert nmse(drives, predicted) == pytest.approx(expected)
    assert np.isnan(nmse(drives, [Prediction(np.full_like(d.target, np.nan)) for d in drives]))


def test_calibrated_sigma_fits_the_errors(drives: list[LabelledDrive]) -> None:
    rng, scale = np.random.default_rng(0), Scale.from_drives(drives)
    errors, sigma = [rng.normal(size=d.target.shape) for d in drives], np.full_like(drives[0].target, 0.5)
    predicted = [Prediction(d.target + error, sigma, sigma) for d, error in zip(drives, errors, strict=True)]
    new = scale.calibrated(drives, predicted)
    ratio = np.concatenate([np.where(d.valid, np.abs(e), np.nan) for d, e in zip(drives, errors, strict=True)]) / 0.5
    if drives[0].ahead_m:
        assert np.nanquantile(ratio, WITHIN, axis=0) == pytest.approx(new.sigma_factor)
    else:
        assert np.nanmean(ratio**2, axis=0) == pytest.approx(new.sigma_factor**2)
    assert np.nanquantile(ratio, 0.95, axis=0) == pytest.approx(new.interval_95 * new.sigma_factor)


def test_a_range_that_is_never_driven(drives: list[LabelledDrive]) -> None:
    graphs, labels = drives[0].graphs.parent, drives[0].labels.parent
    for name in NAMES:
        artefacts.write_labels(labels / f"{name}.h5", name, np.full(40, 0.1), np.arange(40), ahead_m=[0, 5, 100])
    with pytest.raises(InputError, match=r"no frame is followed by a path from 5 to 100 m in 2026.*labels\.ahead_m"):
        Scale.from_drives(read_drives(graphs, labels, NAMES, 4, predict="path"))


def test_targets_of_a_step_are_standardised_weighted_and_mirrored() -> None:
    scale = Scale(["steering_rad"], np.ones(1), np.array([0.5]), np.zeros(1))
    batch = {
        "target": torch.tensor([[0.2], [-0.3], [0.0]]),
        "base": torch.tensor([0.1, 0.0, 0.0]),
        "valid": torch.tensor([[True], [True], [False]]),
    }
    plain = fit.step_targets(batch, scale, alpha=2.0, mirror=False, dtype=torch.float64)
    assert plain["residual"][:, 0].tolist() == pytest.approx([0.2, -0.6, 0.0])
    assert plain["weight"][:, 0].tolist() == pytest.approx([np.exp(0.4), np.exp(0.6), 0.0])
    both = fit.step_targets(batch, scale, alpha=2.0, mirror=True, dtype=torch.float64)
    assert torch.equal(both["residual"], torch.cat([plain["residual"], -plain["residual"]]))
    assert torch.equal(both["weight"], torch.cat([plain["weight"], plain["weight"]]))


@pytest.mark.parametrize("robust", [False, True])
def test_uncertainty_adds_its_likelihood_and_leaves_the_mean_alone(robust: bool) -> None:
    predicted = torch.tensor([[0.5, 0.1, -1.0, 0.3], [9.0, 0.2, 0.0, 0.5]], requires_grad=True)
    target, weight = torch.tensor([[0.2, 0.4], [0.0, 0.3]]), torch.tensor([[2.0, 1.0], [1.0, 0.0]])
    mean, log_sigma = predicted.chunk(2, dim=1)
    plain = fit.weighted_loss(mean, target, weight, robust)
    assert plain.item() == pytest.approx((weight * LOSS[robust](mean - target)).sum().item())
    if robust:
        likelihood = log_sigma + LOSS[True]((mean - target) / log_sigma.exp())
    else:
        likelihood = -torch.distributions.Normal(mean, log_sigma.exp()).log_prob(target) - np.log(2 * np.pi) / 2
    loss = fit.weighted_loss(predicted, target, weight, robust)
    assert loss.item() == pytest.approx((plain + (weight * likelihood).sum()).item())
    (alone,), (both,) = (torch.autograd.grad(value, predicted, retain_graph=True) for value in (plain, loss))
    assert torch.equal(alone[:, :2], both[:, :2])
    assert both[0, 2:].all()
