"""What perception gets wrong, put into training: what a network is told of the street errs, what to steer there stays.

The sample's perception knows its world too well; on a real street, depth is off by a factor and in waves, classes are
taken for others or not seen, and parts of the view are missing. Errors last as long as a run, as real ones do: what
flickers from frame to frame a recurrent network averages away.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.camera import classes as c
from pipeline.sections.train import Noise
from pipeline.train.augment import faster
from pipeline.train.windows import Batch

TAKEN_FOR = {
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
"""What a class is plausibly taken for."""
WAVES = 3  # cosines of which an error in waves is the mean
VIEW_RAD = np.pi / 4  # to either side: about where an image ends


def disturbed(batch: Batch, frames: Sequence[int], rngs: Sequence[np.random.Generator], settings: Noise) -> Batch:
    """Return a batch with targets as perception would have told it with an error of its own in each run.

    Points keep their edges and neighbourhoods, which perception's errors would change a little. Points are left out of
    kNN graphs only: from PointNet++'s neighbourhoods they cannot be taken cheaply. Images stay as they are.

    Args:
        frames: how many each run has.
        rngs: of each run what is drawn for it, so that nothing depends on the runs beside it.
    """
    if "image" in batch or settings == Noise():
        return batch
    of_runs = batch["ptr"][np.cumsum([0, *frames])]
    xyz, cls, kept, speed = batch["xyz"].copy(), batch["cls"].copy(), np.ones(len(batch["cls"]), bool), []
    for start, stop, rng in zip(of_runs[:-1], of_runs[1:], rngs, strict=True):
        run = slice(start, stop)
        speed.append((1 + settings.speed) ** rng.uniform(-1, 1))
        bearing = np.arctan2(xyz[run, 0], xyz[run, 2])
        xyz[run] *= _depth(xyz[run], bearing, settings, rng)[:, None]
        cls[run] = _mistaken(cls[run], bearing, settings, rng)
        kept[run] = _seen(bearing, settings, rng)
    batch = batch | faster(batch, np.repeat(np.array(speed, np.float32), frames)) | {"xyz": xyz, "cls": cls}
    return batch if kept.all() or "degree" not in batch else without(batch, ~kept)


def _depth(xyz: np.ndarray, bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return how many times too far each point [P] seems: off by a factor, and in waves over bearing and distance."""
    factor = (1 + settings.depth_scale) ** rng.uniform(-1, 1)
    distance = 0.5 * np.log(np.square(xyz).sum(axis=1) + 1)
    off = np.zeros_like(bearing)
    for _ in range(WAVES):
        off += np.cos(int(rng.integers(0, 5)) * bearing + rng.uniform(-2, 2) * distance + rng.uniform(0, 2 * np.pi))
    return np.float32(factor) * (1 + off * np.float32(settings.depth_waves / WAVES))


def _mistaken(cls: np.ndarray, bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return the classes [P] with some taken for others on one side of a bearing, and some not seen at all."""
    table = np.arange(256, dtype=np.uint8)
    for own, others in TAKEN_FOR.items():
        if rng.random() < settings.confused:
            table[own] = rng.choice(others)
    side = (bearing - rng.uniform(-VIEW_RAD, VIEW_RAD)) * rng.choice([-1, 1]) > 0
    cls = np.where(side, table[cls], cls)
    unseen = np.arange(256, dtype=np.uint8)
    unseen[: c.COUNT][rng.random(c.COUNT) < settings.missing] = c.VOID
    return unseen[cls]


def _seen(bearing: np.ndarray, settings: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return which points [P] remain: some are dropped, and none are seen in a sector that something hides."""
    seen = rng.random(len(bearing), np.float32) >= rng.uniform(0, settings.dropped)
    centre, width = rng.uniform(-VIEW_RAD, VIEW_RAD), np.deg2rad(rng.uniform(0, settings.hidden_deg))
    return seen & (np.abs(bearing - centre) >= width / 2)


def without(batch: Batch, dropped: np.ndarray) -> Batch:
    """Return a batch of kNN graphs without the points in `dropped` bool [N], nor the edges that end at one."""
    kept, degree, indices = ~dropped, batch["degree"], batch["indices"]
    entries = np.repeat(kept, degree) & kept[indices]
    before = np.concatenate([[0], np.cumsum(entries)])  # of each entry, how many stay before it
    stops = np.cumsum(degree, dtype=np.int64)
    left = before[stops] - before[stops - degree]  # neighbours of each point
    place = np.cumsum(kept, dtype=indices.dtype) - 1  # new number of each point that stays
    return batch | {
        "xyz": batch["xyz"][kept],
        "cls": batch["cls"][kept],
        "ptr": np.concatenate([[0], np.cumsum(kept)])[batch["ptr"]],
        "degree": left[kept].astype(degree.dtype),
        "indices": place[indices[entries]],
    }
