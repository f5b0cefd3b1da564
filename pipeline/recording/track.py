"""Speed and yaw rate of a GNSS receiver's track: derivatives of its positions, or of the velocities that it says."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.town.oxts import EARTH_RADIUS_M

# Parabolas are fitted over this time: at 10 Hz of KITTI's own track, half of it triples the angle's squared error.
SMOOTH_S = 1.0
# Or over so many fixes, where they are rarer: positions have to be derived twice, velocities once.
LEAST_POSITIONS, LEAST_VELOCITIES = 5, 3
MIN_SPEED_MPS = 1.0  # slower, the course is noise


@dataclass(frozen=True)
class Fixes:
    """A receiver's track, time ascending.

    time_s [N] since 1970 (UTC), latitude_deg and longitude_deg [N], velocity_mps [N,2] to the east and to the north,
    None if the receiver does not say it.
    """

    time_s: np.ndarray
    latitude_deg: np.ndarray
    longitude_deg: np.ndarray
    velocity_mps: np.ndarray | None


@dataclass(frozen=True)
class Rates:
    """time_s, speed_mps, yaw_rate_radps (left positive), all [N], and where and how the first sample stands."""

    time_s: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: np.ndarray
    latitude_deg: float = 0.0
    longitude_deg: float = 0.0
    heading_rad: float = 0.0
    """Counter-clockwise from east."""

    def later(self, offset_s: float) -> "Rates":
        return replace(self, time_s=self.time_s + offset_s)


def rates_of(fixes: Fixes, path: Path) -> tuple[Rates, str]:
    """Return speed and yaw rate at the fixes, and the rule by which they were made, in words.

    Positions, or velocities where the receiver says them, are brought to even steps, the median between fixes, and
    fitted by parabolas over SMOOTH_S (Savitzky-Golay), whose derivatives are velocity v and acceleration a: the speed
    is |v|, the yaw rate, the course's derivative, (v × a) / v². Below MIN_SPEED_MPS it is 0.

    Raises InputError, which names `path`, if there are too few fixes.
    """
    from scipy.signal import savgol_filter

    says = fixes.velocity_mps is not None
    least = LEAST_VELOCITIES if says else LEAST_POSITIONS
    if len(fixes.time_s) < least:
        raise InputError(f"{path} has {len(fixes.time_s)} fixes with a time: {least} are the least to smooth over")
    step_s = float(np.median(np.diff(fixes.time_s)))
    even_s = np.arange(fixes.time_s[0], fixes.time_s[-1] + step_s / 2, step_s)
    fitted = max(least, 2 * round(SMOOTH_S / step_s / 2) + 1)
    if len(even_s) < fitted:
        raise InputError(f"{path} lasts {fixes.time_s[-1] - fixes.time_s[0]:.1f} s, which is too short to smooth")

    values = fixes.velocity_mps if fixes.velocity_mps is not None else _to_plane(fixes)
    values = np.column_stack([np.interp(even_s, fixes.time_s, column) for column in values.T])
    v, a = (
        savgol_filter(values, fitted, polyorder=2, deriv=order + (not says), delta=step_s, axis=0) for order in (0, 1)
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
    )
    return rates, (
        f"speed and course of {'its velocities' if says else 'its positions'}, fitted by parabolas over {fitted} fixes "
        f"({(fitted - 1) * step_s:.2g} s); the yaw rate is the course's derivative, below {MIN_SPEED_MPS:g} m/s 0"
    )


def _to_plane(fixes: Fixes) -> np.ndarray:
    """Return metres to the east and to the north [N,2]; each step at its own latitude, however long the track is."""
    latitude, longitude = np.deg2rad(fixes.latitude_deg), np.unwrap(np.deg2rad(fixes.longitude_deg))
    east = EARTH_RADIUS_M * np.cos((latitude[1:] + latitude[:-1]) / 2) * np.diff(longitude)
    north = EARTH_RADIUS_M * np.diff(latitude)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([east, north], axis=-1), axis=0)])
