"""Counts, sizes, runs of frame numbers and tables, as people read them."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

_MOST_GAPS = 8  # that are spelled out


def frames(one: Mapping[str, Any]) -> str:
    """Return how many frames there are, from which to which, and what is missing between."""
    if not one["count"]:
        return "no frames"
    missing = f"missing {spans(one['gaps'])}" if one["gaps"] else "no gaps"
    return f"{one['count']} frames, {one['first']} to {one['last']} in {one['duration_s']:.1f} s, {missing}"


def spans(gaps: list[list[int]]) -> str:
    """Return runs of frame numbers, as 3, 7-9."""
    words = [str(first) if first == last else f"{first}-{last}" for first, last in gaps[:_MOST_GAPS]]
    return ", ".join([*words, f"… ({len(gaps)} gaps)"] if len(gaps) > _MOST_GAPS else words)


def size(count: float) -> str:
    """Return bytes as people read them."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} B" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"


def table(rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Yield rows as lines whose columns stand below each other."""
    rows = list(rows)
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))] if rows else []
    for row in rows:
        yield "  " + "  ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)).rstrip()


def many(count: int, what: str) -> str:
    """Return a count with its noun, as 1 drive, 2 drives."""
    return f"{count} {what}{'' if count == 1 else 's'}"
