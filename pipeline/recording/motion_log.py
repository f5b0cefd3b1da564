"""What a car's own sensors said of its motion, on their own clock: a CSV file, or a GNSS receiver's track."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.recording.gnss import read_gpx, read_nmea
from pipeline.recording.track import Rates, rates_of

COLUMNS = ("time_s", "speed_mps", "yaw_rate_radps")
_UNITS = "time_s in seconds, speed_mps in m/s and yaw_rate_radps in rad/s, left positive"


@dataclass(frozen=True)
class MotionLog:
    """Samples, time ascending, and how they were made of what the file holds, for people to read."""

    rates: Rates
    source: str


def read_motion(path: Path, offset_s: float = 0.0) -> MotionLog:
    """Read a CSV, GPX or NMEA file, told apart by how it begins.

    Args:
        path: a CSV file with the columns time_s, speed_mps and yaw_rate_radps, in any order, and others, which are
            ignored; or a track, whose times are seconds since 1970 (UTC), made rates by :func:`track.rates_of`.
        offset_s: is added to the file's times.

    Raises InputError if the file is not one of these, lacks a column, or time does not increase.
    """
    if not path.is_file():
        raise InputError(f"{path} is no file: --motion wants a CSV file with {_UNITS}, or a GPX or NMEA track")
    with path.open("rb") as file:
        if b"\0" in file.read(4096):  # a video may have gigabytes
            raise InputError(f"{path} is not text: --motion wants a CSV file with {_UNITS}, or a GPX or NMEA track")
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    kind = text.lstrip()[:1]
    if kind in ("<", "$", "!"):
        fixes = read_gpx(text, path) if kind == "<" else read_nmea(text, path)
        rates, rule = rates_of(fixes, path)
        source = f"{len(rates.time_s)} fixes of {path}: {rule}"
    else:
        rates = _read_csv(text, path)
        source = f"{len(rates.time_s)} samples of {path}"
    return MotionLog(rates.later(offset_s), source)


def _read_csv(text: str, path: Path) -> Rates:
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text), delimiter=delimiter, skipinitialspace=True)
    header = [name.strip() for name in next(reader, [])]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        names = ", ".join(header) or "nothing"
        raise InputError(
            f"{path} has no column {' and no '.join(missing)}: its first line names {names}; give {_UNITS}"
        )
    places = [header.index(name) for name in COLUMNS]
    rows = [_numbers(row, places, path, reader.line_num) for row in reader if any(row)]
    if len(rows) < 2:
        raise InputError(f"{path} has {len(rows)} samples: two are the least between which there is motion")
    time_s, speed_mps, yaw_rate_radps = np.array(rows).T
    late = np.flatnonzero(np.diff(time_s) <= 0)
    if len(late):
        i = int(late[0])
        raise InputError(
            f"{path}: time_s goes from {time_s[i]:.15g} to {time_s[i + 1]:.15g} at sample {i + 2}, it must increase: "
            "sort the file, and keep one sample of each time"
        )
    return Rates(time_s, speed_mps, yaw_rate_radps)


def _numbers(row: list[str], places: list[int], path: Path, line: int) -> list[float]:
    try:
        values = [float(row[place]) for place in places]
    except (IndexError, ValueError):
        values = [np.nan]
    if not np.isfinite(values).all():
        raise InputError(f"{path}, line {line}: {', '.join(COLUMNS)} are not three numbers: mend or remove the line")
    return values
