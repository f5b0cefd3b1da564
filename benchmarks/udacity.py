"""Udacity's Challenge 2: the steering wheel's angle of a real drive, beside the predictions of
three leading teams.

python -m benchmarks.udacity VIDEO CSV LEADERBOARD

VIDEO has the frames of the test drive Ch2_001, CSV their time_s and wheel_rad (left positive, by
CAN), LEADERBOARD the teams' predictions for the same frames: komanda_rad, rambo_rad, autumn_rad.
Three constants turn the angle that steer measure finds, or its yaw rate alone, into the wheel's.
They are fitted on the first FITTED_S; the rest is compared.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.outputs import claimed
from pipeline.ingest.datasets import udacity
from pipeline.labels.label import Car
from pipeline.report.origin import origin
from steer.api import here_or_in_checkout
from steer.chain import Source
from steer.commands.measure import STREET
from steer.measure import measure

FITTED_S = 30.0
LAGS_S = np.arange(-0.2, 0.41, 0.02)  # of the measured motion behind the wheel
TEAMS = ("komanda", "rambo", "autumn")


class Wheel(NamedTuple):
    """The wheel's angle by a measured angle or rate: gain · measured + offset, and the
    measurement's lag.
    """

    gain: float
    offset_rad: float
    lag_s: float

    def angle(self, time_s: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Return the wheel's angle [F] in rad at `time_s` [F] by measurements [F] at these
        times.
        """
        return self.gain * np.interp(time_s + self.lag_s, time_s, measured) + self.offset_rad


def fit(time_s: np.ndarray, measured: np.ndarray, wheel_rad: np.ndarray) -> Wheel:
    """Return the constants with the least squared error, all arguments [F]."""
    wheels = []
    for lag_s in LAGS_S.tolist():
        gain, offset = np.polyfit(
            np.interp(time_s + lag_s, time_s, measured), wheel_rad, deg=1
        ).tolist()
        wheels.append(Wheel(gain, offset, lag_s))
    return min(
        wheels, key=lambda wheel: float(((wheel.angle(time_s, measured) - wheel_rad) ** 2).mean())
    )


def compare(
    video: Annotated[Path, typer.Argument(help="the drive's frames")],
    wheel: Annotated[
        Path, typer.Argument(metavar="CSV", help="time_s and wheel_rad of the frames")
    ],
    leaderboard: Annotated[Path, typer.Argument(help="the teams' predictions of the frames")],
) -> None:
    """Measure the drive, compare with the teams, and write motion.csv and results.json to
    out/udacity.
    """
    with claimed(None, "udacity") as out:
        _compare(video, wheel, np.genfromtxt(leaderboard, delimiter=",", names=True), out)


def _compare(video: Path, wheel: Path, teams: np.ndarray, out: Path) -> None:
    drive = udacity.read_drive(video, wheel)
    assert drive.camera
    source = Source(video, video.stem, drive, drive.camera, len(drive.values["steering_rad"]), {})
    measure(source, out, here_or_in_checkout(STREET), Car(2.7, min_speed_mps=1.0), video=False)
    motion = np.genfromtxt(out / "motion.csv", delimiter=",", names=True, usecols=range(1, 9))
    wheel_rad = udacity.STEERING_RATIO * np.array([*drive.values["steering_rad"].values()])
    time_s = motion["time_s"]
    first, rest = time_s < FITTED_S, time_s >= FITTED_S
    predicted = {"zero": np.zeros_like(wheel_rad), **{team: teams[f"{team}_rad"] for team in TEAMS}}
    fits = {}
    for row, column in (
        ("steer measure", "measured_rad"),
        ("its yaw rate alone", "yaw_rate_radps"),
    ):
        known = np.isfinite(motion[column])  # other frames: linear between their neighbours
        measured = np.interp(time_s, motion["time_s"][known], motion[column][known])
        fits[row] = fit(time_s[first], measured[first], wheel_rad[first])
        predicted[row] = fits[row].angle(time_s, measured)
    rmse = {
        name: float(np.sqrt(((angle - wheel_rad)[rest] ** 2).mean()))
        for name, angle in predicted.items()
    }
    results = {name: {"value": value} for name, value in rmse.items()}
    store.write_json(
        out / "results.json",
        {"preset": "udacity"} | origin() | {"results": results},
        sort_keys=False,
    )
    print("| wheel's angle | RMSE rad |", "|---|--:|", sep="\n")
    for name, value in sorted(rmse.items(), key=lambda item: -item[1]):
        print(f"| {name} | {value:.4f} |")
    print(f"\nframes measured: {(motion['valid'] > 0).mean():.1%}; {fits['steer measure']}")


if __name__ == "__main__":
    console.run(compare)
