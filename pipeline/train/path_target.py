"""Scale of the outputs of a network that predicts the path ahead, and its predictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from pydantic import Field, FiniteFloat

from pipeline.base.errors import InputError
from pipeline.labels import label
from pipeline.train.labelled_drive import LabelledDrive

if TYPE_CHECKING:
    from torch import Tensor


WITHIN = 0.6827  # share of a normal distribution within one standard deviation


class PathPrediction(NamedTuple):
    """Predicted path ahead of G frames, [G,R] in 1/m, left positive; NaN where no complete window ends.

    With uncertainty also its standard deviation.
    """

    path_1pm: np.ndarray
    sigma_1pm: np.ndarray | None = None


@dataclass(frozen=True)
class PathTarget:
    """Scale of the R outputs, from the training drives: κ_r = base_r · κ + std_r · output_r.

    κ_r is the mean curvature in range r of `ahead_m`, and κ the measured curvature at the window's last frame, or 0
    without motion and with base: none. base_r is the regression coefficient of κ_r on κ, and std_r the standard
    deviation of the residual. So output 0 means the best prediction from κ alone. `coefficients` are regression
    coefficients by kind of measured motion, for baselines. With uncertainty, σ_r = std_r · sigma_factor_r · exp(output
    R + r); the factors are chosen so that ±σ contains 68 % of the validation drives' errors in each range.
    """

    ahead_m: list[FiniteFloat]  # R+1 edges
    base: list[FiniteFloat]  # [R]
    std_1pm: list[Annotated[FiniteFloat, Field(gt=0)]]  # [R]
    wheelbase_m: FiniteFloat
    min_speed_mps: FiniteFloat
    coefficients: dict[str, list[FiniteFloat]] = field(default_factory=dict)
    sigma_factor: list[FiniteFloat] = field(default_factory=list)  # [R]; none: 1

    @classmethod
    def from_drives(cls, drives: Sequence[LabelledDrive]) -> "PathTarget":
        """Raise InputError if the drives never drive on to the end of a range."""
        car, edges = drives[0].car, drives[0].ahead_m
        path = np.concatenate([drive.path_1pm for drive in drives])  # [N,R]
        for (near, far), driven in zip(pairwise(edges), np.isfinite(path).any(axis=0), strict=True):
            if not driven:
                names = ", ".join(drive.name for drive in drives)
                problem = f"predict: path: no frame is followed by a path from {near:g} to {far:g} m in {names}"
                raise InputError(problem, drives[0].labels.parent, "Add longer drives, or shorten labels.ahead_m")
        kinds = [kind for kind in drives[0].measured_rad if all(kind in drive.measured_rad for drive in drives)]
        coefficients = {
            kind: _regress(np.concatenate([drive.measured_1pm(kind) for drive in drives]), path) for kind in kinds
        }
        curvature = np.tan(np.concatenate([drive.base_rad for drive in drives])) / car.wheelbase_m
        base = _regress(curvature, path)
        std = np.nanstd(path - np.array(base) * curvature[:, None], axis=0)
        return cls(list(edges), base, np.maximum(std, 1e-6).tolist(), **vars(car), coefficients=coefficients)

    @property
    def car(self) -> label.Car:
        return label.Car(self.wheelbase_m, self.min_speed_mps)

    @property
    def outputs(self) -> int:
        return len(self.std_1pm)

    def residual(self, batch: Mapping[str, "Tensor"]) -> "Tensor":
        """Return the outputs [W,R] that the network should have, from a batch's targets."""
        import torch

        curvature = batch["base_rad"].tan() / self.wheelbase_m
        # Numbers as scalars: a tensor made of them would be a blocking copy to a GPU in each step.
        columns = zip(batch["path_1pm"].unbind(1), self.base, self.std_1pm, strict=True)
        return torch.stack([(path - base * curvature) / std for path, base, std in columns], dim=1)

    def decode(self, output: "Tensor", base_rad: np.ndarray) -> np.ndarray:
        """Return the path ahead [R,W] in 1/m of a network's output [W,R]; of [W,2R] with its σ, [2R,W]."""
        curvature, std = np.tan(base_rad) / self.wheelbase_m, np.array(self.std_1pm)[:, None]
        values = output.double().cpu().numpy().T
        path = np.array(self.base)[:, None] * curvature + std * values[: self.outputs]
        if len(values) == self.outputs:
            return path
        factor = np.array(self.sigma_factor or [1.0])[:, None]
        return np.concatenate([path, std * factor * np.exp(values[self.outputs :])])

    def columns(self, uncertainty: bool) -> int:
        """Return the number of rows of :meth:`decode`."""
        return self.outputs * (1 + uncertainty)

    def prediction(self, values: np.ndarray) -> PathPrediction:
        """Return :meth:`decode`'s values, collected for G frames [R or 2R, G]."""
        return PathPrediction(*(part.T for part in np.split(values, len(values) // self.outputs)))

    def calibrated(self, drives: Sequence[LabelledDrive], predictions: Sequence[PathPrediction]) -> "PathTarget":
        """Return the target whose ±σ contains 68 % of the errors on the drives; a range without any keeps factor 1."""
        true = np.concatenate([drive.path_1pm for drive in drives])
        path = np.concatenate([prediction.path_1pm for prediction in predictions])
        sigma = np.concatenate([prediction.sigma_1pm for prediction in predictions if prediction.sigma_1pm is not None])
        ratios = (ratio[np.isfinite(ratio)] for ratio in (np.abs(path - true) / sigma).T)
        return replace(self, sigma_factor=[float(np.quantile(r, WITHIN)) if len(r) else 1.0 for r in ratios])

    def nmse(self, drives: Sequence[LabelledDrive], predictions: Sequence[PathPrediction]) -> float:
        """Return the mean over the ranges of MSE / MSE of the straight path; NaN if every path is straight."""
        true = np.concatenate([drive.path_1pm for drive in drives])
        error = np.concatenate([prediction.path_1pm for prediction in predictions]) - true
        zero = np.where(np.isnan(error), 0.0, true**2).sum(axis=0)
        known = zero > 0
        return float((np.nansum(error**2, axis=0)[known] / zero[known]).mean()) if known.any() else np.nan


def _regress(curvature_1pm: np.ndarray, path_1pm: np.ndarray) -> list[float]:
    """Return the regression coefficient of each range's path [N,R] on the curvature [N]; 0 without a bend."""
    known = np.isfinite(path_1pm) & np.isfinite(curvature_1pm)[:, None]
    k = np.where(known, curvature_1pm[:, None], 0.0)
    square = (k**2).sum(axis=0)
    product = (k * np.where(known, path_1pm, 0.0)).sum(axis=0)
    return np.divide(product, square, out=np.zeros_like(square), where=square > 0).tolist()
