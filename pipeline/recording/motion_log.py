"""Read logs: a car's motion from a CSV file or a GNSS receiver's track, and angles of its steering wheel."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import MiB, check_file, read_columns
from pipeline.camera.footage import check_times
from pipeline.kitti.steering_file import check_angles, check_frames
from pipeline.recording.gnss import read_gpx, read_nmea
from pipeline.recording.track import Rates, coverage, rates_of

COLUMNS = ("time_s", "speed_mps", "yaw_rate_radps")
_EXPECTED = "Expected a CSV file with time_s [s], speed_mps [m/s], yaw_rate_radps [rad/s, left +]; or GPX or NMEA"
_MOST_BYTES = 512 * MiB  # 10 million samples
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
