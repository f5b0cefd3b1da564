"""Labels of a drive from each source: oxts, measured motion (visual), or recorded steering angles (wheel).

Labels of measured motion are Gaussian means over neighbouring frames, later ones included. A model must not get these
as inputs.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.kitti.oxts import VF, WU
from pipeline.labels.label import Car, Labels, steering_labels
from pipeline.motion.step import LEAST_MPS, LEAST_NOISE, PROBLEMS, STANDSTILL, filter_speed

# Standard deviations of the means. A driver turns the wheel in a second, and a car changes its speed more slowly; a
# speed from one pair of images has much more noise than a yaw rate.
YAW_SIGMA_S, SPEED_SIGMA_S = 0.2, 0.5
REACH = 2.0  # sigmas on both sides
YAW_NOISE_RADPS = 0.003  # least error of a yaw rate: KITTI odometry 03 has 0.2 deg/s
_CHOOSE_ANOTHER = "Set labels.source in params.yaml to a source that all drives have, for instance visual"


def recorded(raw: DriveReader) -> list[str]:
    """Return the sources in an ingest file: those that were recorded, not measured."""
    return [source for source, name in {"oxts": "oxts", "wheel": "steering_rad"}.items() if name in raw]


def read(source: str, raw: DriveReader, motion: Path | None, car: Car, *, look_ahead: bool = True) -> Labels:
    """Return a drive's labels, valid from the car's minimum speed on.

    A recorded angle is also valid at unknown speed, unless the motion is unknown because nothing moves. With source
    wheel, speed and yaw rate are read from oxts or, in a drive without oxts, from measured motion.

    `raw`, `motion`: the drive's files of stages ingest and motion. With `look_ahead`, measured rates are means over
    neighbouring frames, later ones included, which a target may know; else the causal rates that models get.

    Raises InputError if the drive lacks the source.
    """
    if source in ("oxts", "wheel") and source not in recorded(raw):
        missing = {"oxts": "no oxts", "wheel": "no recorded steering angles (steering.csv)"}[source]
        raise InputError(f"drive has {missing}, which labels.source: {source} needs", raw.path, _CHOOSE_ANOTHER)
    speed_mps, yaw_rate_radps, still = np.full((3, len(raw.frame)), np.nan)
    if motion:
        with DriveReader(motion, stage="motion") as file:
            rates, rows = measured_rates(file, look_ahead=look_ahead), np.searchsorted(raw.frame, file.frame)
            speed_mps[rows], yaw_rate_radps[rows], still[rows] = rates.speed_mps, rates.yaw_rate_radps, stands(file)
    if source != "visual" and "oxts" in raw:
        speed_mps, yaw_rate_radps = raw["oxts"][:, VF], raw["oxts"][:, WU]
    steering_rad, valid = steering_labels(yaw_rate_radps, speed_mps, **vars(car))
    if source == "wheel":
        unknown = ~np.isfinite(speed_mps) & (still != 1)
        steering_rad, valid = raw["steering_rad"], (valid | unknown) & raw["has_steering"].astype(bool)
    return Labels(steering_rad, valid, speed_mps, yaw_rate_radps)


class Rates(NamedTuple):
    """Yaw rates in rad/s, left positive, forward speeds in m/s, and standard deviations; the speed's is relative."""

    yaw_rate_radps: np.ndarray
    speed_mps: np.ndarray
    yaw_sigma_radps: np.ndarray
    speed_sigma: np.ndarray


def measured_rates(motion: DriveReader, *, look_ahead: bool) -> Rates:
    """Return the rates in a file of stage motion, all [F], NaN where not measured.

    `look_ahead`: as :func:`means`; False: the causal rates.
    """
    valid, rates = motion["valid"].astype(bool), np.full((4, len(motion.frame)), np.nan)
    names = ("yaw_rate_radps", "speed_mps", "filtered_mps", "speed_sigma", "road_height_m")
    yaw, speed, filtered, sigma, road_m = (motion[name][valid].astype(np.float64) for name in names)
    causal = Rates(yaw, filtered, np.full(len(yaw), YAW_NOISE_RADPS), sigma)
    rates[:, valid] = means(motion.time_s[valid], yaw, speed, road_m > 0) if look_ahead else causal
    return Rates(*rates)


def stands(motion: DriveReader) -> np.ndarray:
    """Return bool [F]: the motion of a frame is not measured because nothing moves."""
    return np.isin(motion["problem"], [PROBLEMS.index(text) for text in STANDSTILL])


def means(time_s: np.ndarray, yaw_rate_radps: np.ndarray, speed_mps: np.ndarray, road: np.ndarray) -> Rates:
    """Return means of raw rates [M] of the measured frames at times [M]; the means of the speed are then filtered.

    `road`: whether a road was found, bool [M].
    """
    yaw, yaw_error = _means(time_s, yaw_rate_radps, YAW_SIGMA_S)
    speed, speed_error = _means(time_s, speed_mps, SPEED_SIGMA_S)
    noise = np.maximum(LEAST_NOISE, speed_error / np.maximum(np.abs(speed), LEAST_MPS))
    filtered, sigma = filter_speed(time_s, speed, road, noise)
    return Rates(yaw, filtered, np.maximum(YAW_NOISE_RADPS, yaw_error), sigma)


def _means(time_s: np.ndarray, values: np.ndarray, sigma_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gaussian mean of `values` [M] around each time [M], and its error.

    The error is that of independent noise, whose consecutive differences have a median of 0.954 standard deviations.
    """
    result = np.zeros((2, len(time_s)))
    reach_s = REACH * max(YAW_SIGMA_S, SPEED_SIGMA_S)
    starts = np.searchsorted(time_s, time_s - reach_s, "left")
    stops = np.searchsorted(time_s, time_s + reach_s, "right")
    for row, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        near, seconds = values[start:stop], time_s[start:stop] - time_s[row]
        weights = np.exp(-((seconds / sigma_s) ** 2) / 2) * (np.abs(seconds) <= REACH * sigma_s)
        weights /= weights.sum()
        error = float(np.median(np.abs(np.diff(near)))) / 0.954 if len(near) > 1 else 0.0
        result[:, row] = weights @ near, error * np.sqrt(weights @ weights)
    return result[0], result[1]
