"""Augmentation: a run of frames as a mirrored or a rescaled world would have shown it, and what to steer there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.sections.train import Train
from pipeline.train.windows import Batch

ANGLES = ("steering_rad", "base_rad")  # of each window


@dataclass(frozen=True)
class Change:
    """What augmentation does to each of a step's runs [R]: whether it is mirrored, and how much larger its world is."""

    mirrored: np.ndarray
    factor: np.ndarray

    @classmethod
    def draw(cls, runs: int, settings: Train, rng: np.random.Generator) -> "Change":
        mirrored = rng.random(runs) < 0.5 if settings.mirror else np.zeros(runs, bool)
        factor = settings.rescale ** rng.uniform(-1, 1, runs) if settings.rescale > 1 else np.ones(runs)
        return cls(mirrored, factor.astype(np.float32))

    def of(self, runs: Sequence[int]) -> "Change":
        return Change(self.mirrored[list(runs)], self.factor[list(runs)])

    def apply(self, batch: Batch, frames: Sequence[int]) -> Batch:
        """Change a batch with targets whose runs are `frames` long each."""
        batch = mirror(batch, np.repeat(self.mirrored, frames))
        return rescale(batch, np.repeat(self.factor, frames))


def mirror(batch: Batch, chosen: np.ndarray) -> Batch:
    """Reflect the spans' windows and points, or images, left-right: x → −x, steering → −steering; every edge stays.

    What the car did is reflected likewise. `chosen` bool [B]: which of the batch's frames to reflect; all frames of a
    span together.
    """
    sign = np.where(chosen, -1, 1).astype(np.int8)
    changed = {name: batch[name] * sign[batch["windows"][:, -1]] for name in ANGLES}
    if "motion" in batch:
        changed["motion"] = batch["motion"].copy()
        changed["motion"][:, :2] *= sign[:, None]  # angle and yaw rate
    if "image" in batch:  # KITTI's optical axis meets the image within 2 % of its middle
        changed["image"] = batch["image"].copy()
        changed["image"][chosen] = batch["image"][chosen, :, ::-1]
    else:
        changed["xyz"] = batch["xyz"].copy()
        changed["xyz"][:, 0] *= np.repeat(sign, np.diff(batch["ptr"]))
    return batch | changed


def rescale(batch: Batch, factor: np.ndarray) -> Batch:
    """Make the world of each frame `factor` [B] times as large, and its bends as much wider; every edge stays.

    The car goes as much faster, and turns as fast as it did: the bicycle model's tan Θ is wheelbase times curvature,
    and curvature is 1 / length. All frames of a span together.
    Images stay as they are, and so does their steering: a larger world gives the same image.
    """
    if "image" in batch:
        return batch
    return (
        batch
        | faster(batch, factor)
        | {
            "xyz": batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None],
            "steering_rad": as_much_wider(batch["steering_rad"], factor[batch["windows"][:, -1]]),
        }
    )


def faster(batch: Batch, factor: np.ndarray) -> Batch:
    """Return the motion, and its angle, of a car that drives `factor` [B] times as fast and turns as fast as it did."""
    changed = {"base_rad": as_much_wider(batch["base_rad"], factor[batch["windows"][:, -1]])}
    if "motion" in batch:
        measured_rad, yaw_rate_radps, speed_mps, valid = batch["motion"].T
        columns = [as_much_wider(measured_rad, factor), yaw_rate_radps, speed_mps * factor, valid]
        changed["motion"] = np.stack(columns, axis=1)
    return changed


def as_much_wider(steering_rad: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the steering angle in bends whose radius is `factor` times as large."""
    return np.arctan(np.tan(steering_rad) / factor)
