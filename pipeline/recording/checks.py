"""Check sizes, values and times of a recording's files, so that errors name the file and not a later stage."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError

LATEST_S = 4e9  # since 1970: year 2096


def check_size(path: Path, most_bytes: int) -> None:
    """Raise InputError if a file is too large to read into memory."""
    size = path.stat().st_size
    if size > most_bytes:
        limit = f"expected at most {most_bytes >> 20} MiB, got {size >> 20}"
        raise InputError(f"file is too large ({limit})", path, "Cut it to the recording")


def check_limit(name: str, values: np.ndarray, limit: float, path: Path) -> None:
    """Raise InputError if one of `values` [N] is not finite or its magnitude exceeds `limit`."""
    wrong = ~(np.abs(values) <= limit)
    if wrong.any():
        at = int(np.argmax(wrong))
        problem = f"implausible {name} = {values[at]:g} at sample {at + 1} (limit ±{limit:g})"
        raise InputError(problem, path, "Correct or remove the sample")


def check_times(time_s: np.ndarray, path: Path) -> None:
    """Raise InputError if times [N] are implausible or do not increase."""
    check_limit("time_s", time_s, LATEST_S, path)
    wrong = np.diff(time_s) <= 0
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(
            f"time goes from {time_s[at]:.15g} to {time_s[at + 1]:.15g} at sample {at + 2} (expected an increase)",
            path,
            "Sort the file and remove repeated times",
        )
