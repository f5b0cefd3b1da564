"""Simulate how often a nominal 95 % interval contains the truth: ``python -m benchmarks.coverage OUT [KITTI]``.

The base of all errors is the regression of the angle a second ahead on the present one, on drives that move as those of
the sample, without images, or on the oxts of a folder in KITTI raw's layout. The squared errors of two models are
multiples of it, by a random factor per seed, per road, and per seed and road. The true difference is that over all
drives, roads and seeds. OUT is for ``docs/make_results.py collect OUT coverage``.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.evaluate.errors import interval
from pipeline.kitti.oxts import VF, WU, read_row
from pipeline.kitti.raw import KittiDrive
from pipeline.labels.label import steering_labels
from pipeline.sample.drive import random_of, theme
from pipeline.sample.motion import draw_journey
from pipeline.sample.oxts import oxts_rows
from pipeline.sample.plan import draw_character
from pipeline.settings.evaluate import Evaluate
from pipeline.settings.labels import Labels

AHEAD = 10  # frames
TESTED = {"6 drives": 6, "20 drives": 20, "60 drives": 60, "1 drive as long as 60": 60}
SEEDS = (3, 5)
LENGTHS = (40, 93)  # frames of a drive of the sample
DRIVES, DRAWS = 1000, 500  # of which test sets are drawn; test sets
ROAD = 100  # frames of a road
NMSE = (0.146, 0.124)  # of two models
# Of the log error by seed: sa-gnn-ncp has .100 .149 .171 .207 .105, with an LSTM .183 .098 .095 .150 .095.
SEED_SD = 0.31
# Of the log error by road, and by road and seed. So the log ratio of two networks' errors on a drive has a standard
# deviation of 1.09; on the demo's 20 test drives it is 1.06.
ROAD_SD, BOTH_SD = 0.5, 0.5
Drive = tuple[np.ndarray, np.ndarray]
"""Squared errors [F], NaN where they do not count, and true angles [F]."""


def main(
    out: Annotated[Path, typer.Argument(help="JSON file to write")],
    kitti: Annotated[Path | None, typer.Argument(help="folder in KITTI raw's layout")] = None,
    params: Path = Path("params.yaml"),
) -> None:
    """Write and print the share of the intervals that contain the true difference, by drives and seeds."""
    settings, car, figures = load(Evaluate, params), load(Labels, params), {}
    names = [f"2027_01_{1 + number % 28:02d}_drive_{number:04d}" for number in range(DRIVES)]
    worlds = {f"{frames} frames": [angles(sample(name, frames), car) for name in names] for frames in LENGTHS}
    if kitti:
        worlds["KITTI"] = [angles(recorded(path), car) for path in sorted(kitti.glob("*/*_sync"))]
    for (world, moved), seeds, (name, tested) in product(worlds.items(), SEEDS, TESTED.items()):
        share = coverage(predict(moved), tested, seeds, settings, joined=name.startswith("1 "))
        figures[f"{name}/{world}, {seeds} seeds"] = {"figure": share}
        print(f"{name}, {world}, {seeds} seeds: {share:.1%} of {DRAWS} intervals", flush=True)
    store.write_json(out, figures)


def sample(drive: str, frames: int) -> np.ndarray:
    """Return the yaw rates and speeds [2,F] of a drive of the sample."""
    rng, (quarter, first) = random_of(drive, 0), theme(drive)
    journey = draw_journey(rng, frames, draw_character(rng, quarter), first).continued()
    return oxts_rows(journey, 49.0, 8.4)[: frames + AHEAD, [WU, VF]].T


def recorded(folder: Path) -> np.ndarray:
    """Return the yaw rates and speeds [2,F] of a drive of KITTI raw."""
    return np.array([read_row(path) for path in KittiDrive(folder).oxts.values()])[:, [WU, VF]].T


def angles(rates: np.ndarray, car: Labels) -> np.ndarray:
    """Return a drive's angles [2,F] in rad, present (0 without a valid label) and AHEAD frames later (NaN)."""
    angle, valid = steering_labels(*rates, wheelbase_m=car.wheelbase_m, min_speed_mps=car.min_speed_mps)
    return np.stack([np.where(valid, angle, 0.0)[:-AHEAD], np.where(valid, angle, np.nan)[AHEAD:]])


def predict(moved: Sequence[np.ndarray]) -> list[Drive]:
    """Return the errors of the regression on all drives [2,F], scaled to an nmse of 1."""
    present, later = np.concatenate(moved, axis=1)
    gain = np.nansum(present * later) / (present**2)[np.isfinite(later)].sum()
    nmse = np.nansum((gain * present - later) ** 2) / np.nansum(later**2)
    return [((gain * present - later) ** 2 / nmse, later) for present, later in moved]


def coverage(drives: Sequence[Drive], tested: int, seeds: int, settings: Evaluate, joined: bool) -> float:
    """Return the share of DRAWS test sets whose interval contains the true difference of two models.

    A test set has `tested` of the drives, or one drive that consists of them if they are `joined`.
    """
    rng, hits, true = np.random.default_rng(0), 0, NMSE[0] - NMSE[1]
    for _ in range(DRAWS):
        chosen = [drives[number] for number in rng.integers(len(drives), size=tested)]
        error, truth = (np.concatenate(values) for values in zip(*chosen, strict=True))
        drive = np.repeat(np.arange(tested), [len(values) for values, _ in chosen])
        row = np.concatenate([np.arange(len(values)) for values, _ in chosen])
        road = np.cumsum(np.diff(drive * len(row) + row // ROAD, prepend=0) != 0)  # [N]
        first, second = (nmse * error * _factors(rng, seeds, road[-1] + 1)[:, road] for nmse in NMSE)
        low, high = interval(first, truth, drive * (not joined), settings, second) or (np.nan, np.nan)
        hits += low <= true <= high
    return hits / DRAWS


def _factors(rng: np.random.Generator, seeds: int, roads: int) -> np.ndarray:
    """Return random factors [S, roads] with a mean of 1 over seeds and roads."""
    parts = ((SEED_SD, (seeds, 1)), (ROAD_SD, (1, roads)), (BOTH_SD, (seeds, roads)))
    return np.prod([rng.lognormal(-(sd**2) / 2, sd, shape) * np.ones((seeds, roads)) for sd, shape in parts], axis=0)


if __name__ == "__main__":
    console.run(main)
