"""Read a car's motion on its own clock: a CSV file, or a GNSS receiver's track."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.recording.checks import check_size
from pipeline.recording.gnss import read_gpx, read_nmea
from pipeline.recording.track import Rates, rates_of

COLUMNS = ("time_s", "speed_mps", "yaw_rate_radps")
_EXPECTED = "Expected a CSV file with time_s [s], speed_mps [m/s], yaw_rate_radps [rad/s, left +]; or GPX or NMEA"
_MOST_BYTES = {"CSV": 1 << 29, "track": 1 << 27}  # 10 million samples; gpxpy takes 10 times a file's size


@dataclass(frozen=True)
class MotionLog:
    """Samples, time ascending, and a description of their source for the log."""

    rates: Rates
    source: str


def read_motion(path: Path, offset_s: float = 0.0) -> MotionLog:
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
    kind = "track" if first in (b"<", b"$", b"!") else "CSV"
    check_size(path, _MOST_BYTES[kind])
    if kind == "CSV":
        rates = _read_csv(path)
        return MotionLog(rates.later(offset_s), f"{len(rates.time_s)} samples of {path}")
    fixes = read_gpx(path) if first == b"<" else read_nmea(path)
    rates, rule = rates_of(fixes, path)
    return MotionLog(rates.later(offset_s), f"{len(rates.time_s)} fixes of {path}: {rule}")


def _read_csv(path: Path) -> Rates:
    import pandas as pd

    with path.open(encoding="utf-8-sig", errors="replace") as file:
        header = file.readline(1 << 16)
    separator = max(",;\t", key=header.count)
    names = [name.strip(' "\r\n') for name in header.split(separator)]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise InputError(f"has no column {', '.join(missing)} (got {', '.join(names)})", path, _EXPECTED)
    try:
        table = pd.read_csv(
            path,
            sep=separator,
            header=0,
            names=names,
            index_col=False,
            usecols=list(COLUMNS),
            dtype=np.float64,
            skipinitialspace=True,
            encoding="utf-8-sig",
            encoding_errors="replace",
        )
    except ValueError as error:  # pandas' parser errors too
        raise InputError(f"is not a table of numbers ({error})", path, "Correct or remove the line") from error
    rates = Rates(*(table[name].to_numpy() for name in COLUMNS))
    rates.check(path)
    return rates
