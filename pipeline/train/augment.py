"""Augmentation: change the size of the scene together with the steering, and simulate perception errors.

SteeringNet.forward mirrors. The sample's perception is fitted to its own world and too good. On real streets, depth is
off by a factor and in waves, classes are confused or missing, and parts of the view are hidden. The steering does not
change with such errors. An error is constant over a run, as real ones are: a recurrent network averages out errors that
change from frame to frame.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.camera import classes as c
from pipeline.sections.train import Noise
from pipeline.train.windows import Batch

CONFUSED_WITH = {
    c.ROAD: (c.SIDEWALK, c.TERRAIN),
    c.SIDEWALK: (c.ROAD, c.TERRAIN),
    c.BUILDING: (c.WALL, c.FENCE, c.VEGETATION),
    c.WALL: (c.BUILDING, c.FENCE, c.VEGETATION),
    c.FENCE: (c.WALL, c.BUILDING, c.VEGETATION),
    c.POLE: (c.VEGETATION, c.BUILDING),
    c.TRAFFIC_LIGHT: (c.TRAFFIC_SIGN, c.BUILDING),
    c.TRAFFIC_SIGN: (c.BUILDING, c.VEGETATION),
    c.VEGETATION: (c.TERRAIN, c.BUILDING, c.FENCE),
    c.TERRAIN: (c.SIDEWALK, c.ROAD, c.VEGETATION),
    c.PERSON: (c.RIDER, c.VEGETATION),
    c.RIDER: (c.PERSON, c.BICYCLE),
    c.CAR: (c.TRUCK, c.BUS),
    c.TRUCK: (c.CAR, c.BUS, c.BUILDING),
    c.BUS: (c.TRUCK, c.CAR, c.BUILDING),
    c.TRAIN: (c.BUS, c.BUILDING),
    c.MOTORCYCLE: (c.BICYCLE, c.CAR),
    c.BICYCLE: (c.MOTORCYCLE, c.PERSON),
}
"""Class → similar classes."""
WAVES = 3  # cosines in a wave error
VIEW_RAD = np.pi / 4  # half the width of the view


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


def add_noise(batch: Batch, frames: Sequence[int], rngs: Sequence[np.random.Generator], settings: Noise) -> Batch:
    """Return a batch with targets with the errors of perception, drawn for each run.

    Edges and neighbourhoods do not change, though real errors would change some. Points are removed from kNN graphs
    only, since it is expensive for PointNet++ neighbourhoods. Images do not change.

    Args:
        frames: length of each run.
        rngs: generator of each run, so that a run's errors do not depend on the others.
    """
    if "image" in batch or settings == Noise():
        return batch
    ptr = batch["ptr"][np.cumsum([0, *frames])]
    xyz, cls, visible, speed = batch["xyz"].copy(), batch["cls"].copy(), np.ones(len(batch["cls"]), bool), []
    for start, stop, rng in zip(ptr[:-1], ptr[1:], rngs, strict=True):
        run = slice(start, stop)
        speed.append((1 + settings.speed) ** rng.uniform(-1, 1))
        bearing = np.arctan2(xyz[run, 0], xyz[run, 2])
        xyz[run] *= _depth_factor(xyz[run], bearing, settings, rng)[:, None]
        cls[run] = _confuse_classes(cls[run], bearing, settings, rng)
        visible[run] = _visible(bearing, settings, rng)
    changed = {"xyz": xyz, "cls": cls} | scale_speed(batch, np.repeat(np.array(speed, np.float32), frames))
    return batch | changed if visible.all() or "degree" not in batch else remove_points(batch | changed, ~visible)


def _depth_factor(xyz: np.ndarray, bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return the factor of each point's distance [P]: a constant times waves over bearing and distance."""
    factor = (1 + settings.depth_scale) ** rng.uniform(-1, 1)
    distance = 0.5 * np.log(np.square(xyz).sum(axis=1) + 1)
    waves = np.zeros_like(bearing)
    for _ in range(WAVES):
        waves += np.cos(int(rng.integers(0, 5)) * bearing + rng.uniform(-2, 2) * distance + rng.uniform(0, 2 * np.pi))
    return np.float32(factor) * (1 + waves * np.float32(settings.depth_waves / WAVES))


def _confuse_classes(cls: np.ndarray, bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return the classes [P], some replaced by similar ones on one side of a bearing, and some by void."""
    table = np.arange(256, dtype=np.uint8)
    for own, others in CONFUSED_WITH.items():
        if rng.random() < settings.confused:
            table[own] = rng.choice(others)
    side = (bearing - rng.uniform(-VIEW_RAD, VIEW_RAD)) * rng.choice([-1, 1]) > 0
    cls = np.where(side, table[cls], cls)
    missing = np.arange(256, dtype=np.uint8)
    missing[: c.COUNT][rng.random(c.COUNT) < settings.missing] = c.VOID
    return missing[cls]


def _visible(bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return which points [P] remain: random ones are dropped, and all in a sector."""
    visible = rng.random(len(bearing), np.float32) >= rng.uniform(0, settings.dropped)
    centre, width = rng.uniform(-VIEW_RAD, VIEW_RAD), np.deg2rad(rng.uniform(0, settings.hidden_deg))
    return visible & (np.abs(bearing - centre) >= width / 2)


def remove_points(batch: Batch, removed: np.ndarray) -> Batch:
    """Return a batch of kNN graphs without the points in `removed` bool [N] and their edges."""
    remaining, degree, indices = ~removed, batch["degree"], batch["indices"]
    entries = np.repeat(remaining, degree) & remaining[indices]
    before = np.concatenate([[0], np.cumsum(entries)])  # remaining entries before each entry
    stops = np.cumsum(degree, dtype=np.int64)
    left = before[stops] - before[stops - degree]  # neighbours of each point
    place = np.cumsum(remaining, dtype=indices.dtype) - 1  # new number of each remaining point
    return batch | {
        "xyz": batch["xyz"][remaining],
        "cls": batch["cls"][remaining],
        "ptr": np.concatenate([[0], np.cumsum(remaining)])[batch["ptr"]],
        "degree": left[remaining].astype(degree.dtype),
        "indices": place[indices[entries]],
    }
