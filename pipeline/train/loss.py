"""The loss of a network, and the scale of its R output columns, from the training drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from pipeline.base.errors import InputError
from pipeline.base.metrics import nmse
from pipeline.train.targets import LabelledDrive


@dataclass(frozen=True)
class Scale:
    """y = gain · base + offset + std · output, in each of R columns.

    - y is the predicted value.
    - base is the measured value of the window's last frame, or 0 for a model without motion or with
      `base: none`.
    - gain is the regression coefficient of y on base if the quantity lies ahead of the car, or 1.
    - offset is the mean of y - gain · base, or 0 for an odd quantity, as left and right are alike.
    - std is the standard deviation of y - gain · base.

    So an output of 0 means the best prediction from base alone. `mean` is that of y, and serves a
    baseline. All arrays are float64 [R].
    """

    names: list[str]  # Quantity.columns
    gain: np.ndarray
    offset: np.ndarray
    std: np.ndarray
    mean: np.ndarray

    @classmethod
    def from_drives(cls, drives: Sequence[LabelledDrive]) -> "Scale":
        """Return the scale of the training drives.

        Raises InputError if no frame has a target in one of the columns.
        """
        quantity = drives[0].quantity
        y = np.concatenate([drive.target for drive in drives])
        for number, name in enumerate(quantity.ranges):
            if not np.isfinite(y[:, number]).any():
                names = ", ".join(drive.name for drive in drives)
                problem = f"no frame has a known {quantity.title} {name}".rstrip()
                fix = "Add longer drives, or shorten the ranges in section labels"
                raise InputError(f"{problem} in {names}", drives[0].labels.parent, fix)

        base = np.concatenate([drive.base for drive in drives])
        gain = fit_gain(base, y) if quantity.is_ahead else np.ones(y.shape[1])
        rest = y - gain * base
        offset = np.zeros(y.shape[1]) if quantity.is_odd else np.nanmean(rest, axis=0)
        std = np.maximum(np.nanstd(rest, axis=0), 1e-6)  # it is 0 on a straight road
        return cls(quantity.columns, gain, offset, std, np.nanmean(y, axis=0))

    @classmethod
    def parse(cls, content: dict[str, Any]) -> "Scale":
        """Return the scale that has this :attr:`content`. Raises TypeError or ValueError.

        Older checkpoints lack ``offset``, which was 0, and have ``odometry_gain``, which stage
        evaluate fits now.
        """
        fields = {name: value for name, value in content.items() if name != "odometry_gain"}
        arrays = {name: np.array(value) for name, value in fields.items() if name != "names"}
        arrays.setdefault("offset", np.zeros_like(arrays["std"]))
        return cls(**fields | arrays)

    @property
    def content(self) -> dict[str, Any]:
        """The fields, with arrays as lists."""
        fields = vars(self).items()
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in fields}

    def decode(self, output: np.ndarray, base: np.ndarray) -> np.ndarray:
        """Return the predictions of outputs for base, each [...,R]."""
        return np.asarray(self.gain * base + self.offset + self.std * output)


def mean_nmse(drives: Sequence[LabelledDrive], predictions: Sequence[np.ndarray]) -> float:
    """Return the nmse, averaged over the columns; NaN if every target is 0."""
    targets = np.concatenate([drive.target for drive in drives])
    columns = zip(targets.T, np.concatenate(predictions).T, strict=True)
    values = []
    for truth, predicted in columns:
        is_known = np.isfinite(predicted - truth)
        value = nmse(truth[is_known], predicted[is_known])
        if value is not None:
            values.append(value)
    return float(np.mean(values)) if values else np.nan


def fit_gain(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the regression coefficients [R] of y [N,R] on x [N,R], without offset.

    They are 0 where x is 0.
    """
    is_known = np.isfinite(x) & np.isfinite(y)
    x = np.where(is_known, x, 0.0)
    y = np.where(is_known, y, 0.0)
    square = (x**2).sum(axis=0)
    return np.divide((x * y).sum(axis=0), square, out=np.zeros_like(square), where=square > 0)


def batch_targets(
    batch: Mapping[str, Tensor], gain: Tensor, offset: Tensor, std: Tensor, alpha: float
) -> tuple[Tensor, Tensor]:
    """Return the outputs that the network should have, and their weights, both [W,R].

    A weight is exp(α |target|) as in eq. 9, and 0 for an unknown target. `gain`, `offset` and `std`
    [R] are the fields of :class:`Scale`.
    """
    base = batch["base"].to(std.dtype)
    target = batch["target"].to(std.dtype)
    is_known = target.isfinite()
    target = target.nan_to_num()  # 0 × NaN is NaN
    residual = (target - gain * base - offset) / std
    return residual, is_known * torch.exp(alpha * target.abs())


def weighted_loss(predicted: Tensor, target: Tensor, weight: Tensor, robust: bool) -> Tensor:
    """Return Σ w (ŷ - y)² over windows and columns [W,R].

    Divided by Σ w, this sum is paper eq. 9. With `robust` the sum is Σ w Huber(ŷ - y), which is
    linear beyond one standard deviation. Raises ValueError if the shapes differ, as torch would
    broadcast them.
    """
    if predicted.shape != target.shape:
        shapes = f"{list(predicted.shape)}, the targets {list(target.shape)}"
        raise ValueError(f"the network's outputs have the shape {shapes}")
    criterion = nn.functional.huber_loss if robust else nn.functional.mse_loss
    return (weight * criterion(predicted, target, reduction="none")).sum()
