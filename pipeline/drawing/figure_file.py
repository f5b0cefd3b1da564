"""Write matplotlib figures: the same figure gives the same bytes."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from pipeline.base.atomic import replacing

_METADATA = {".png": {"Software": None}, ".svg": {"Date": None, "Creator": None}}


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write `figure` to a PNG or SVG file in one step, without a date or a version number in it."""
    with mpl.rc_context({"svg.hashsalt": "steering", "svg.fonttype": "none"}), replacing(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=dpi, metadata=_METADATA[path.suffix])
