"""Augment spans: change the size of the scene together with its targets. Mirroring is in SteeringNet.forward."""

from collections.abc import Sequence

import numpy as np

from pipeline.graphs.graph_file import Arrays


def rescale(batch: Arrays, factor: np.ndarray, ahead_m: Sequence[float] = ()) -> Arrays:
    """Multiply lengths, radii and speed of each frame by `factor` [B], which is equal within a span.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    Images and their steering do not change: a larger world gives the same image. `ahead_m`: the R+1 edges of a path's
    ranges, as in :func:`scale_path`.
    """
    if "image" in batch:
        return batch
    scaled = batch | scale_speed(batch, factor)
    scaled["xyz"] = batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]
    last = factor[batch["windows"][:, -1]]
    if "path_1pm" in batch:
        scaled["path_1pm"], scaled["valid"] = scale_path(batch["path_1pm"], batch["valid"], ahead_m, last)
    else:
        scaled["steering_rad"] = scale_radius(batch["steering_rad"], last)
    return scaled


def scale_path(
    path_1pm: np.ndarray, valid: np.ndarray, ahead_m: Sequence[float], factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the path ahead [W,R] in a world `factor` [W] times as large, and where it is known.

    A range there is 1 / factor of it here, so it overlaps several ranges of the labels, whose curvature counts as
    constant within each. Where one of these is not valid, or the labels end, the path is 0 and not known.
    """
    near, far = np.array(ahead_m[:-1], np.float32), np.array(ahead_m[1:], np.float32)
    scale = factor[:, None, None]
    overlap_m = np.minimum(far[:, None] / scale, far) - np.maximum(near[:, None] / scale, near)  # [W,R,R]
    share = np.maximum(overlap_m, 0) * scale / (far - near)[:, None]
    known = (share * valid[:, None]).sum(axis=2) > 1 - 1e-4
    scaled = (share * np.where(valid, path_1pm, 0)[:, None]).sum(axis=2) / factor[:, None]
    return np.where(known, scaled, 0).astype(path_1pm.dtype), known


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
