"""Write matplotlib figures: the same figure gives the same bytes."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError

_WRITER = "semantic-steering"
_METADATA = {".png": {"Software": _WRITER}, ".svg": {"Date": None, "Creator": None}}


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write `figure` to a PNG or SVG file in one step, without a date or a version number in it."""
    with mpl.rc_context({"svg.hashsalt": "steering", "svg.fonttype": "none"}), replacing(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=dpi, metadata=_METADATA[path.suffix])


def check_replaceable(path: Path) -> None:
    """Raise InputError if there is something else at `path` than a PNG file of :func:`save`."""
    if not path.is_symlink() and not path.exists():
        return
    if path.is_symlink() or not path.is_file() or f"Software\0{_WRITER}".encode() not in _head(path):
        raise InputError("steer did not write this file, so it is not replaced", path, "Pass another name: --out")


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(1 << 10)
