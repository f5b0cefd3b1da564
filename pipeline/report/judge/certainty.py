"""Scores of predicted standard deviations."""

import math

import numpy as np

COVERED = {"68": 1.0, "95": 1.96}
"""Share of a normal distribution in per cent → half of the interval, in standard deviations."""


def scores(steering_rad: np.ndarray, predicted_rad: np.ndarray, sigma_rad: np.ndarray) -> dict[str, float]:
    """Return means over S seeds' predictions [S,N] with standard deviations [S,N].

    - nll: mean negative log-likelihood of a normal distribution, in nats; nll_constant: the same with one σ for all
      frames, the RMSE on these frames, which is the best constant.
    - coverage_68, coverage_95: share of angles within ±σ and ±1.96 σ of the prediction.
    - mae_deg_certain: mean error of the half with the smaller σ.
    """
    error = np.abs(predicted_rad - steering_rad)
    rmse = np.sqrt(np.mean(error**2, axis=1, keepdims=True))
    by_sigma = np.take_along_axis(error, np.argsort(sigma_rad, axis=1), axis=1)
    return {
        "nll": _nll(error, sigma_rad),
        "nll_constant": _nll(error, np.broadcast_to(rmse, error.shape)),
        **{f"coverage_{share}": float(np.mean(error <= width * sigma_rad)) for share, width in COVERED.items()},
        "mae_deg_certain": float(np.rad2deg(by_sigma[:, : (error.shape[1] + 1) // 2].mean())),
    }


def _nll(error: np.ndarray, sigma: np.ndarray) -> float:
    return float(np.mean(np.log(sigma) + (error / sigma) ** 2 / 2 + math.log(2 * math.pi) / 2))
