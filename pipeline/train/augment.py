"""Augment spans: change the size of the scene together with the steering. Mirroring is in SteeringNet.forward."""

import numpy as np

from pipeline.graphs.graph_file import Arrays


def rescale(batch: Arrays, factor: np.ndarray) -> Arrays:
    """Multiply lengths, radii and speed of each frame by `factor` [B], which is equal within a span.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    Images and their steering do not change: a larger world gives the same image. Scenes with a path ahead do not change
    either: its ranges are distances, and the labels have no path in scaled ranges.
    """
    if "image" in batch or "path_1pm" in batch:
        return batch
    scaled = batch | scale_speed(batch, factor)
    scaled["xyz"] = batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]
    scaled["steering_rad"] = scale_radius(batch["steering_rad"], factor[batch["windows"][:, -1]])
    return scaled


def scale_speed(batch: Arrays, factor: np.ndarray) -> Arrays:
    """Return motion and base angle with the speed multiplied by `factor` [B], at the same yaw rate."""
    changed = {"base_rad": scale_radius(batch["base_rad"], factor[batch["windows"][:, -1]])}
    if "motion" in batch:
        measured_rad, yaw_rate_radps, speed_mps, valid = batch["motion"].T
        columns = [scale_radius(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
        changed["motion"] = np.stack(columns, axis=1)
    return changed


def scale_radius(steering_rad: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
