"""GPX and NMEA tracks, as gpxpy and pynmea2 read them (pip install -e '.[gps]')."""

from collections.abc import Iterable
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


def read_gpx(text: str, path: Path) -> Fixes:
    """Return the points of all tracks that have a time. Raises InputError, which names `path`."""
    gpxpy = _library("gpxpy", "GPX")
    try:
        points = gpxpy.parse(text).walk(only_points=True)
    except gpxpy.gpx.GPXException as error:
        raise InputError(f"{path} is not a GPX file: {error}") from error
    fixes = (
        _Fix(point.time, point.latitude, point.longitude, point.speed, point.course) for point in points if point.time
    )
    return _fixes(fixes, path, "points with a time")


def read_nmea(text: str, path: Path) -> Fixes:
    """Return the fixes of its RMC sentences, which have date, place, speed and course. Raises InputError.

    Sentences that are damaged, by their checksum, are left out.
    """
    pynmea2 = _library("pynmea2", "NMEA")
    sentences = (line.strip() for line in text.splitlines() if line[3:6] == "RMC")
    fixes = (fix for sentence in sentences if (fix := _of_sentence(pynmea2, sentence)))
    return _fixes(fixes, path, "RMC sentences with a fix")


def _of_sentence(pynmea2: ModuleType, sentence: str) -> _Fix | None:
    try:
        rmc = pynmea2.parse(sentence)
        if not rmc.is_valid:  # no fix yet
            return None
        knots = rmc.spd_over_grnd
        speed_mps = None if knots is None else float(knots) * _KNOT_MPS
        return _Fix(rmc.datetime, rmc.latitude, rmc.longitude, speed_mps, rmc.true_course)
    except (ValueError, TypeError):  # pynmea2 raises both for garbage
        return None


def _fixes(fixes: Iterable[_Fix], path: Path, what: str) -> Fixes:
    """Return the fixes as arrays; those whose time is not after all before are said twice, and left out."""
    kept: dict[float, _Fix] = {}
    last_s = -np.inf
    for fix in fixes:
        time = fix.time if fix.time.tzinfo else fix.time.replace(tzinfo=UTC)
        if time.timestamp() > last_s:
            last_s = time.timestamp()
            kept[last_s] = fix
    if not kept:
        raise InputError(f"{path} has no {what}")
    velocities = [_velocity(fix) for fix in kept.values()]
    said = [velocity for velocity in velocities if velocity is not None]
    latitude_deg, longitude_deg = (
        np.array([getattr(fix, name) for fix in kept.values()]) for name in ("latitude_deg", "longitude_deg")
    )
    velocity_mps = np.array(said) if len(said) == len(kept) else None
    return Fixes(np.array(list(kept)), latitude_deg, longitude_deg, velocity_mps)


def _velocity(fix: _Fix) -> tuple[float, float] | None:
    """Return the velocity to the east and to the north; a car that stands has no course."""
    if fix.speed_mps is None or (fix.course_deg is None and fix.speed_mps >= MIN_SPEED_MPS):
        return None
    course = np.deg2rad(fix.course_deg or 0.0)
    return float(fix.speed_mps * np.sin(course)), float(fix.speed_mps * np.cos(course))


def _library(name: str, kind: str) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise InputError(f"{kind} files are read by {name}, which is not installed: pip install -e '.[gps]'") from error
