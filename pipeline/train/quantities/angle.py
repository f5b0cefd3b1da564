"""The steering angle of a frame (paper section 4.1)."""

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.train.quantity import Quantity, scale_radius


class Target(Quantity):
    title = "steering angle"
    unit = "rad"
    shown_title = "steering angle"
    shown_unit = "deg"
    shown_format = ".2f"
    columns = ["steering_rad"]

    def read(self, labels: DriveReader) -> np.ndarray:
        return np.where(labels["valid"], labels["steering_rad"], np.nan)[:, None]

    def measured(self, angle_rad: np.ndarray) -> np.ndarray:
        return angle_rad[:, None]

    def rescale(self, values: np.ndarray, factor: float) -> np.ndarray:
        return scale_radius(values, factor)

    def shown(self, values: np.ndarray) -> np.ndarray:
        return np.rad2deg(values[..., 0])

    def curvature(self, values: np.ndarray) -> np.ndarray:
        return np.tan(values) / self.car.wheelbase_m
