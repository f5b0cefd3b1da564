"""Read GPX and NMEA tracks with gpxpy and pynmea2 (pip install -e '.[gps]')."""

import importlib
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.recording.track import MIN_SPEED_MPS, Fixes

_KNOT_MPS = 1852 / 3600


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
