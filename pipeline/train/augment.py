"""Augmentation: a run of frames as a mirrored or a rescaled world would have shown it, and what to steer there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.sections.train import Train
from pipeline.train.windows import Batch


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

    `chosen` bool [B]: which of the batch's frames to reflect; all frames of a span together.
    """
    steering_rad = batch["steering_rad"].copy()
    steering_rad[chosen[batch["windows"][:, -1]]] *= -1
    if "image" in batch:  # KITTI's optical axis meets the image within 2 % of its middle
        image = batch["image"].copy()
        image[chosen] = image[chosen, :, ::-1]
        return batch | {"image": image, "steering_rad": steering_rad}
    xyz = batch["xyz"].copy()
    xyz[np.repeat(chosen, np.diff(batch["ptr"])), 0] *= -1
    return batch | {"xyz": xyz, "steering_rad": steering_rad}


def rescale(batch: Batch, factor: np.ndarray) -> Batch:
    """Make the world of each frame `factor` [B] times as large, and its bends as much wider; every edge stays.

    The bicycle model's tan Θ is wheelbase times curvature, and curvature is 1 / length. All frames of a span together.
    Images stay as they are, and so does their steering: a larger world gives the same image.
    """
    if "image" in batch:
        return batch
    xyz = batch["xyz"] * np.repeat(factor, np.diff(batch["ptr"]))[:, None]
    steering_rad = np.arctan(np.tan(batch["steering_rad"]) / factor[batch["windows"][:, -1]])
    return batch | {"xyz": xyz, "steering_rad": steering_rad}
