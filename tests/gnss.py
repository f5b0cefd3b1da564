"""Tracks of a receiver in a car that drives along a known curve, as GPX and NMEA files."""

from datetime import UTC, datetime, timedelta

import numpy as np

START = datetime(2027, 3, 31, 10, 0, 0, tzinfo=UTC)
LATITUDE_DEG, LONGITUDE_DEG = 49.0, 8.4
METRES_PER_DEG = 6378137.0 * np.pi / 180


def bend(count: int, step_s: float, speed_mps: float = 9.0, yaw_rate_radps: float = 0.1) -> tuple[np.ndarray, ...]:
    """Return time since START [N], places [N,2] (latitude, longitude) and headings [N] on a circle."""
    time_s = np.arange(count) * step_s
    heading = 0.3 + yaw_rate_radps * time_s
    radius = speed_mps / yaw_rate_radps
    east, north = radius * (np.sin(heading) - np.sin(0.3)), -radius * (np.cos(heading) - np.cos(0.3))
    longitude = LONGITUDE_DEG + east / METRES_PER_DEG / np.cos(np.deg2rad(LATITUDE_DEG))
    return time_s, np.stack([LATITUDE_DEG + north / METRES_PER_DEG, longitude], axis=-1), heading


def gpx(time_s: np.ndarray, places: np.ndarray) -> str:
    """Return a GPX 1.1 file, without speeds."""
    points = [
        f'<trkpt lat="{latitude:.9f}" lon="{longitude:.9f}"><time>{_stamp(time).isoformat()}</time></trkpt>'
        for time, (latitude, longitude) in zip(time_s.tolist(), places.tolist(), strict=True)
    ]
    head = '<?xml version="1.0"?>\n<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'
    return f"{head}<trk><trkseg>{''.join(points)}</trkseg></trk></gpx>\n"


def nmea(time_s: np.ndarray, places: np.ndarray, speed_mps: float | np.ndarray, heading_rad: np.ndarray) -> str:
    """Return RMC sentences; below 1 m/s without a course, as receivers do."""
    lines = []
    speeds = np.broadcast_to(speed_mps, time_s.shape).tolist()
    for time, (latitude, longitude), speed, heading in zip(time_s.tolist(), places, speeds, heading_rad, strict=True):
        stamp = _stamp(time)
        course = f"{np.rad2deg(np.pi / 2 - heading) % 360:.3f}" if speed >= 1 else ""
        lines.append(
            sentence(
                f"GNRMC,{stamp:%H%M%S}.{stamp.microsecond // 10000:02d},A,{_angle(latitude, 2)},N,"
                f"{_angle(longitude, 3)},E,{speed * 3600 / 1852:.4f},{course},{stamp:%d%m%y},,,A"
            )
        )
    return "".join(lines)


def sentence(content: str) -> str:
    """Return a line of NMEA with its checksum."""
    total = 0
    for character in content:
        total ^= ord(character)
    return f"${content}*{total:02X}\r\n"


def _stamp(time_s: float) -> datetime:
    return START + timedelta(seconds=time_s)


def _angle(degrees: float, digits: int) -> str:
    whole = int(degrees)
    return f"{whole:0{digits}d}{(degrees - whole) * 60:010.7f}"
