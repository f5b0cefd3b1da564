"""Read logs: a car's motion from a CSV file or a GNSS receiver's track, and angles of its steering wheel.

GPX and NMEA tracks are read with gpxpy and pynmea2 (pip install -e '.[gps]').
"""

import importlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import MiB, check_file, read_columns
from pipeline.camera.footage import check_times
from pipeline.kitti.steering_file import check_angles, check_frames
from pipeline.recording.track import MIN_SPEED_MPS, Fixes, Rates, coverage, rates_of

COLUMNS = ("time_s", "speed_mps", "yaw_rate_radps")
_EXPECTED = "Expected a CSV file with time_s [s], speed_mps [m/s], yaw_rate_radps [rad/s, left +]; or GPX or NMEA"
_MOST_BYTES = 512 * MiB  # 10 million samples
_KNOT_MPS = 1852 / 3600
_MOST_TRACK_BYTES = 128 * MiB  # gpxpy takes 10 times a file's size


def read_motion(path: Path, offset_s: float = 0.0) -> Rates:
    """Read a CSV, GPX or NMEA file; the first character decides which.

    Args:
        path: a CSV file with the columns time_s, speed_mps and yaw_rate_radps, in any order; or a track, with times in
            seconds since 1970 (UTC), converted to rates by :func:`track.rates_of`.
        offset_s: added to the file's times.

    Raises InputError if the file is too large, lacks a column, has implausible values, or time does not increase.
    """
    if not path.is_file():
        raise InputError("not a regular file", path, _EXPECTED)
    with path.open("rb") as file:
        head = file.read(4096)
    if b"\0" in head:
        raise InputError("not a text file", path, _EXPECTED)
    first = head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    if first in (b"<", b"$", b"!"):
        check_file(path, _MOST_TRACK_BYTES)
        rates = rates_of(read_gpx(path) if first == b"<" else read_nmea(path), path)
    else:
        columns = read_columns(path, COLUMNS, (), _EXPECTED, _MOST_BYTES)
        rates = Rates(**columns, source=f"{len(columns['time_s'])} samples of {path}")  # type: ignore[arg-type]
        rates.check(path)
    return replace(rates, time_s=rates.time_s + offset_s)


@dataclass(frozen=True)
class WheelLog:
    """Angles of the front wheels in rad, left positive, with times or with numbers of images; all [N], ascending."""

    steering_rad: np.ndarray
    time_s: np.ndarray | None
    frame: np.ndarray | None

    def at(self, time_s: np.ndarray, usable: np.ndarray, max_gap_s: float) -> dict[int, float]:
        """Return image number → angle for the `usable` images, bool [F], taken at `time_s` [F].

        Angles are interpolated linearly between samples at most `max_gap_s` apart.
        """
        if self.frame is not None:
            angles = dict(zip(self.frame.tolist(), self.steering_rad.tolist(), strict=True))
        else:
            assert self.time_s is not None
            numbers = np.flatnonzero(coverage(self.time_s, time_s, max_gap_s)[0])
            interpolated = np.interp(time_s[numbers], self.time_s, self.steering_rad)
            angles = dict(zip(numbers.tolist(), interpolated.tolist(), strict=True))
        return {number: angles[number] for number in np.flatnonzero(usable).tolist() if number in angles}

    def angle(self, number: int, time_s: float, max_gap_s: float) -> float | None:
        """Return the angle of image `number`, taken at `time_s`, as :meth:`at`; None if unknown."""
        if self.frame is not None:
            at = int(np.searchsorted(self.frame, number))
            return float(self.steering_rad[at]) if at < len(self.frame) and self.frame[at] == number else None
        assert self.time_s is not None
        covered = coverage(self.time_s, np.array([time_s]), max_gap_s)[0][0]
        return float(np.interp(time_s, self.time_s, self.steering_rad)) if covered else None


def check_ratio(wheel: Path | None, steering_ratio: float | None) -> None:
    """Raise InputError if only one of a file of wheel angles and a steering ratio is given."""
    if (wheel is None) != (steering_ratio is None):
        fix = "Pass both; a ratio of 1 if the log holds angles of the front wheels"
        raise InputError("--wheel and --steering-ratio need each other", fix=fix)


def read_wheel(path: Path, steering_ratio: float, offset_s: float = 0.0) -> WheelLog:
    """Read angles of the steering wheel from a CSV file and divide them by the steering ratio.

    Args:
        path: a CSV file with wheel_rad, left positive, and frame (number of the image, from 0) or time_s.
        offset_s: added to the file's times.

    Raises InputError if the file is too large, lacks a column, has implausible values, or its rows do not ascend.
    """
    expected = "Expected a CSV file with wheel_rad [rad, left +] and frame (number of the image) or time_s [s]"
    if not path.is_file():
        raise InputError("not a regular file", path, expected)
    columns = read_columns(path, ("wheel_rad",), ("frame", "time_s"), expected, _MOST_BYTES)
    steering_rad, frame, time_s = columns["wheel_rad"] / steering_ratio, columns.get("frame"), columns.get("time_s")
    if frame is None and time_s is None:
        raise InputError("has neither frame nor time_s", path, expected)
    if len(steering_rad) < 2:
        raise InputError(f"expected at least 2 samples, got {len(steering_rad)}", path)
    check_angles(steering_rad, path)
    if frame is not None:
        check_frames(frame, path)
        return WheelLog(steering_rad, None, frame.astype(np.int64))
    assert time_s is not None
    check_times(time_s, path)
    return WheelLog(steering_rad, time_s + offset_s, None)


class _Fix(NamedTuple):
    time: datetime
    latitude_deg: float
    longitude_deg: float
    speed_mps: float | None
    course_deg: float | None  # clockwise from north


def read_gpx(path: Path) -> Fixes:
    """Return the points of all tracks that have a time. Raises InputError."""
    gpxpy = _library("gpxpy", path)
    try:
        points = gpxpy.parse(path.read_text(encoding="utf-8-sig", errors="replace")).walk(only_points=True)
    except gpxpy.gpx.GPXException as error:
        raise InputError(f"is not a GPX file ({error})", path) from error
    fixes = (
        _Fix(point.time, point.latitude, point.longitude, point.speed, point.course) for point in points if point.time
    )
    return _collect(fixes, path, "points with a time")


def read_nmea(path: Path) -> Fixes:
    """Return the fixes of RMC sentences, which hold date, position, speed and course. Raises InputError.

    Sentences with a wrong checksum are skipped.
    """
    pynmea2 = _library("pynmea2", path)
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        fixes = (fix for line in lines if line[3:6] == "RMC" and (fix := _parse(pynmea2, line.strip())))
        return _collect(fixes, path, "RMC sentences with a fix")


def _parse(pynmea2: ModuleType, sentence: str) -> _Fix | None:
    try:
        rmc = pynmea2.parse(sentence)
        if not rmc.is_valid:  # no fix yet
            return None
        knots = rmc.spd_over_grnd
        speed_mps = None if knots is None else float(knots) * _KNOT_MPS
        return _Fix(rmc.datetime, rmc.latitude, rmc.longitude, speed_mps, rmc.true_course)
    except (ValueError, TypeError):  # pynmea2 raises both for garbage
        return None


def _collect(fixes: Iterable[_Fix], path: Path, expected: str) -> Fixes:
    """Return the fixes as arrays, without those whose time is not after all earlier ones."""
    by_time: dict[float, _Fix] = {}
    last_s = -np.inf
    for fix in fixes:
        time = fix.time if fix.time.tzinfo else fix.time.replace(tzinfo=UTC)
        if time.timestamp() > last_s:
            last_s = time.timestamp()
            by_time[last_s] = fix
    if not by_time:
        raise InputError(f"has no {expected}", path)
    time_s = np.array(list(by_time))
    return Fixes(
        time_s,
        np.array([fix.latitude_deg for fix in by_time.values()]),
        np.array([fix.longitude_deg for fix in by_time.values()]),
        _velocities(time_s, list(by_time.values())),
    )


def _velocities(time_s: np.ndarray, fixes: Sequence[_Fix]) -> np.ndarray | None:
    """Return velocities east and north [N,2]; None if a speed, or the course of a moving receiver, is unknown.

    Receivers report no course at standstill: it is interpolated between the fixes before and after.
    """
    speed_mps = np.array([np.nan if fix.speed_mps is None else fix.speed_mps for fix in fixes], float)
    course_deg = np.array([np.nan if fix.course_deg is None else fix.course_deg for fix in fixes], float)
    unknown = np.isnan(course_deg)
    if np.isnan(speed_mps).any() or (unknown & (speed_mps >= MIN_SPEED_MPS)).any():
        return None
    course = np.zeros(len(fixes))  # of a receiver that never moves
    if not unknown.all():
        course = np.interp(time_s, time_s[~unknown], np.unwrap(np.deg2rad(course_deg[~unknown])))
    return speed_mps[:, None] * np.stack([np.sin(course), np.cos(course)], axis=-1)


def _library(name: str, path: Path) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(f"the package {name} is not installed", path, "Install it: pip install -e '.[gps]'") from error
