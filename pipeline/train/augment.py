"""Augmentation: mirror and rescale runs of frames together with their steering."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.sections.train import Train
from pipeline.train.windows import Batch

ANGLES = ("steering_rad", "base_rad")  # per window


@dataclass(frozen=True)
class Augmentation:
    """Transformations of a step's runs [R]: whether to mirror each, and the factor of its lengths."""

    mirrored: np.ndarray
    factor: np.ndarray

    @classmethod
    def draw(cls, runs: int, settings: Train, rng: np.random.Generator) -> "Augmentation":
        """Draw the transformations of a number of runs."""
        mirrored = rng.random(runs) < 0.5 if settings.mirror is True else np.zeros(runs, bool)
        factor = settings.rescale ** rng.uniform(-1, 1, runs) if settings.rescale > 1 else np.ones(runs)
        return cls(mirrored, factor.astype(np.float32))

    def select(self, runs: Sequence[int]) -> "Augmentation":
        """Return the transformations of some of the runs."""
        return Augmentation(self.mirrored[list(runs)], self.factor[list(runs)])

    def apply(self, batch: Batch, frames: Sequence[int]) -> Batch:
        """Transform a batch with targets; `frames` is the length of each run."""
        batch = mirror(batch, np.repeat(self.mirrored, frames))
        return rescale(batch, np.repeat(self.factor, frames))


def mirror(batch: Batch, chosen: np.ndarray) -> Batch:
    """Reflect points or images, motion and steering left-right: x → −x, steering → −steering. Edges do not change.

    `chosen` bool [B]: which frames to reflect; equal for all frames of a span.
    """
    sign = np.where(chosen, -1, 1).astype(np.int8)
    changed = {name: batch[name] * sign[batch["windows"][:, -1]] for name in ANGLES}
    if "motion" in batch:
        changed["motion"] = batch["motion"].copy()
        changed["motion"][:, :2] *= sign[:, None]  # angle and yaw rate
    if "image" in batch:  # assumes the optical axis in the middle of the image; KITTI's is within 2 %
        changed["image"] = batch["image"].copy()
        changed["image"][chosen] = batch["image"][chosen, :, ::-1]
    else:
        changed["xyz"] = batch["xyz"].copy()
        changed["xyz"][:, 0] *= np.repeat(sign, np.diff(batch["ptr"]))
    return batch | changed


def rescale(batch: Batch, factor: np.ndarray) -> Batch:
    """Multiply lengths, radii and speed of each frame by `factor` [B]; equal for all frames of a span.

    The bicycle model's tan Θ is wheelbase × curvature, and curvature is 1 / length; the yaw rate does not change.
    Images and their steering do not change: a larger world gives the same image.
    """
    if "image" in batch:
        return batch
    scaled = batch | scale_speed(batch, factor)
    scaled["xyz"] = batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]
    scaled["steering_rad"] = scale_radius(batch["steering_rad"], factor[batch["windows"][:, -1]])
    return scaled


def scale_speed(batch: Batch, factor: np.ndarray) -> Batch:
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
