"""Simulate how often a nominal 95 % interval contains the true error: ``python -m benchmarks.coverage OUT``.

Drives move as those of the sample, without images. The predictor is the regression of the angle a second ahead on the
present one; its true nmse is that over all drives. OUT is for ``docs/make_results.py collect OUT coverage``.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.evaluate.errors import interval
from pipeline.kitti.oxts import VF, WU
from pipeline.labels.label import steering_labels
from pipeline.sample.drive import random_of, theme
from pipeline.sample.motion import draw_journey
from pipeline.sample.oxts import oxts_rows
from pipeline.sample.plan import draw_character
from pipeline.settings.evaluate import Evaluate
from pipeline.settings.labels import Labels

AHEAD = 10  # frames
TESTED = 20  # drives of a test set
LENGTHS = (40, 93)  # frames of a drive
DRIVES, DRAWS = 6000, 2000  # whose mean error is the true one; test sets for which an interval is computed


def main(
    out: Annotated[Path, typer.Argument(help="JSON file to write")],
    params: Path = Path("params.yaml"),
) -> None:
    """Write and print the share of the intervals that contain the true nmse, for drives of both lengths."""
    settings, car, figures = load(Evaluate, params), load(Labels, params), {}
    for frames in LENGTHS:
        moved = [angles(f"2027_01_{1 + n % 28:02d}_drive_{n:04d}", frames, car) for n in range(DRIVES)]
        share = coverage(np.stack(moved), settings)
        figures[f"{TESTED} drives of {frames} frames"] = {"figure": share, "frames": TESTED * frames}
        print(f"{TESTED} drives of {frames} frames: {share:.1%} of {DRAWS} intervals", flush=True)
    store.write_json(out, figures)


def angles(drive: str, frames: int, car: Labels) -> np.ndarray:
    """Return a drive's angles [2,F] in rad, present and AHEAD frames later; NaN: no valid label."""
    rng, (quarter, first) = random_of(drive, 0), theme(drive)
    journey = draw_journey(rng, frames, draw_character(rng, quarter), first).continued()
    rates = oxts_rows(journey, 49.0, 8.4)[: frames + AHEAD, [WU, VF]].T
    angle, valid = steering_labels(*rates, wheelbase_m=car.wheelbase_m, min_speed_mps=car.min_speed_mps)
    return np.stack([angle[:-AHEAD], np.where(valid, angle, np.nan)[AHEAD:]])


def coverage(drives: np.ndarray, settings: Evaluate) -> float:
    """Return the share of DRAWS test sets of TESTED drives whose interval contains the nmse of all drives [D,2,F]."""
    present, later = drives[:, 0], drives[:, 1]
    gain = np.nansum(present * later) / (present**2)[np.isfinite(later)].sum()
    error = (gain * present - later) ** 2
    true = np.nansum(error) / np.nansum(later**2)
    rng, hits, number = np.random.default_rng(0), 0, np.repeat(np.arange(TESTED), drives.shape[2])
    for _ in range(DRAWS):
        drawn = rng.choice(len(drives), TESTED, replace=False)
        low, high = interval(error[drawn].ravel(), later[drawn].ravel(), number, settings) or (np.nan, np.nan)
        hits += low <= true <= high
    return hits / DRAWS


if __name__ == "__main__":
    console.run(main)
