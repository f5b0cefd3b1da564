"""What the work on a drive says about it: counts, and lines of facts, some of which are doubts."""

from collections.abc import Sequence
from typing import Any

# JSON-able facts about a drive, for instance its number of frames.
Summary = dict[str, Any]
# Beginning of a line of facts whose numbers are not those of healthy data.
DOUBT = "doubt: "


def split_doubts(lines: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the lines without a doubt, and the doubts without the word."""
    notes = [line for line in lines if not line.startswith(DOUBT)]
    doubts = [line.removeprefix(DOUBT) for line in lines if line.startswith(DOUBT)]
    return notes, doubts
