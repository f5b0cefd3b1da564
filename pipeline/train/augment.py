"""Augment spans: change the size of the scene together with its targets. Mirroring is in SteeringNet.forward."""

from collections.abc import Sequence

import numpy as np

from pipeline.graphs.graph_file import Arrays


def rescale(batch: Arrays, factor: np.ndarray, ahead_m: Sequence[float] = ()) -> Arrays:
    """Multiply lengths, radii and speed of each frame by `factor` [B], which is equal within a span.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    Images and their steering do not change: a larger world gives the same image. `ahead_m`: the edges of a path's
    ranges, as in :func:`scale_path`; none for an angle.
    """
    if "image" in batch:
        return batch
    last = factor[batch["windows"][:, -1]]
    scaled = batch | {"xyz": batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]}
    if ahead_m:
        scaled["base"] = batch["base"] / last
        scaled["target"], scaled["valid"] = scale_path(batch["target"], batch["valid"], ahead_m, last)
    else:
        scaled["base"] = scale_radius(batch["base"], last)
        scaled["target"] = scale_radius(batch["target"], last[:, None])
    if "motion" in batch:
        measured_rad, yaw_rate_radps, speed_mps, valid = batch["motion"].T
        columns = [scale_radius(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
        scaled["motion"] = np.stack(columns, axis=1)
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


def scale_radius(steering_rad: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the steering angle in bends with `factor` times the radius."""
    return np.arctan(np.tan(steering_rad) / factor)
