"""Speed and yaw rate of a car over time, computed from a GNSS track if need be, and which images they cover."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import check_limit
from pipeline.camera.footage import check_times
from pipeline.kitti.oxts import EARTH_RADIUS_M, LIMITS

# Window of the parabolas: at 10 Hz on KITTI's own track, half of it triples the angle's squared error.
SMOOTH_S = 1.0
# Fewest fixes in a window, for low rates: positions are differentiated twice, velocities once.
LEAST_POSITIONS, LEAST_VELOCITIES = 5, 3
MIN_SPEED_MPS = 1.0  # below, the course is noise
_MOST_FIXES = 1e8  # after resampling
ROUNDING_S = 1e-3  # of timestamps in videos; comparisons tolerate it


@dataclass(frozen=True)
class Fixes:
    """A receiver's track, time ascending.

    time_s [N] since 1970 (UTC), latitude_deg and longitude_deg [N], velocity_mps [N,2] east and north, None if the
    receiver reports none.
    """

    time_s: np.ndarray
    latitude_deg: np.ndarray
    longitude_deg: np.ndarray
    velocity_mps: np.ndarray | None


@dataclass(frozen=True)
class Rates:
    """time_s, speed_mps, yaw_rate_radps (left positive), all [N], and the pose of the first sample.

    ``source`` describes the origin for the log.
    """

    time_s: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    heading_rad: float = 0.0
    """Counter-clockwise from east."""
    source: str = ""

    def check(self, path: Path) -> None:
        """Raise InputError, naming `path`, for too few samples, times that do not increase or implausible values."""
        if len(self.time_s) < 2:
            raise InputError(f"expected at least 2 samples, got {len(self.time_s)}", path)
        check_times(self.time_s, path)
        check_limit("speed_mps", self.speed_mps, LIMITS["vf"], path)
        check_limit("yaw_rate_radps", self.yaw_rate_radps, LIMITS["wu"], path)


def rates_of(fixes: Fixes, path: Path) -> Rates:
    """Return speed and yaw rate at the fixes.

    Velocities, or else positions, are resampled at the median interval and fitted by parabolas over SMOOTH_S
    (Savitzky-Golay), whose derivatives are velocity v and acceleration a: the speed is |v|, the yaw rate (v × a) / v²,
    and 0 below MIN_SPEED_MPS.

    Raises InputError, naming `path`, if there are too few fixes or the result is implausible.
    """
    from scipy.signal import savgol_filter

    measured = fixes.velocity_mps is not None
    least = LEAST_VELOCITIES if measured else LEAST_POSITIONS
    if len(fixes.time_s) < least:
        raise InputError(f"expected at least {least} fixes with a time, got {len(fixes.time_s)}", path)
    check_limit("latitude", fixes.latitude_deg, LIMITS["lat"], path)
    check_limit("longitude", fixes.longitude_deg, LIMITS["lon"], path)
    duration_s = float(fixes.time_s[-1] - fixes.time_s[0])
    step_s = float(np.median(np.diff(fixes.time_s)))
    window = max(least, 2 * round(SMOOTH_S / step_s / 2) + 1)
    if not window <= duration_s / step_s + 1.5 < _MOST_FIXES:
        expected = f"{(window - 1) * step_s:.3g} s or more, at even intervals"
        raise InputError(f"track lasts {duration_s:.1f} s (expected {expected})", path)
    even_s = np.arange(fixes.time_s[0], fixes.time_s[-1] + step_s / 2, step_s)

    values = fixes.velocity_mps if fixes.velocity_mps is not None else _to_plane(fixes)
    values = np.column_stack([np.interp(even_s, fixes.time_s, column) for column in values.T])
    v, a = (
        savgol_filter(values, window, polyorder=2, deriv=order + (not measured), delta=step_s, axis=0)
        for order in (0, 1)
    )
    speed = np.linalg.norm(v, axis=1)
    moving = speed >= MIN_SPEED_MPS
    yaw_rate = np.where(moving, (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / np.where(moving, speed, 1.0) ** 2, 0.0)
    east, north = v[np.argmax(moving)]
    rates = Rates(
        fixes.time_s,
        np.interp(fixes.time_s, even_s, speed),
        np.interp(fixes.time_s, even_s, yaw_rate),
        float(fixes.latitude_deg[0]),
        float(fixes.longitude_deg[0]),
        float(np.arctan2(north, east)),
        f"{len(fixes.time_s)} fixes of {path}: speed and course from {'velocities' if measured else 'positions'}, "
        f"fitted by parabolas over {window} fixes ({(window - 1) * step_s:.2g} s); yaw rate 0 below "
        f"{MIN_SPEED_MPS:g} m/s",
    )
    rates.check(path)
    return rates


def _to_plane(fixes: Fixes) -> np.ndarray:
    """Return metres east and north [N,2]; each step uses its own latitude, so that long tracks are accurate."""
    latitude, longitude = np.deg2rad(fixes.latitude_deg), np.unwrap(np.deg2rad(fixes.longitude_deg))
    east = EARTH_RADIUS_M * np.cos((latitude[1:] + latitude[:-1]) / 2) * np.diff(longitude)
    north = EARTH_RADIUS_M * np.diff(latitude)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([east, north], axis=-1), axis=0)])


def coverage(samples_s: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, dict[str, Any]]:
    """Find the images at `time_s` [F] between two samples at `samples_s` [N] with a gap of at most `max_gap_s`.

    Returns: a mask of these images, bool [F]; and counts of images: ``interpolated`` between two samples, at most
    ``largest_gap_s`` apart; ``left_out`` before the first sample, after the last, and in longer gaps.
    """
    before, after = time_s < samples_s[0] - ROUNDING_S, time_s > samples_s[-1] + ROUNDING_S
    left = np.clip(np.searchsorted(samples_s, time_s, side="right") - 1, 0, len(samples_s) - 2)
    gap_s = samples_s[left + 1] - samples_s[left]
    gap_s[(time_s == samples_s[left]) | (time_s == samples_s[left + 1])] = 0.0
    inside = ~(before | after)
    usable = inside & (gap_s <= max_gap_s + ROUNDING_S)
    return usable, {
        "interpolated": int((gap_s[usable] > 0).sum()),
        "largest_gap_s": float(gap_s[usable].max(initial=0.0)),
        "left_out": {
            "before": int(before.sum()), "after": int(after.sum()), "in_gaps": int((inside & ~usable).sum())
        },
    }  # fmt: skip
