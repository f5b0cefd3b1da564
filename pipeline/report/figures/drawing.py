"""What the figures share: files in two formats without a date in them."""

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from pipeline.base.atomic import replacing


def save(figure: Figure, path: Path) -> None:
    """Write `path`.png and `path`.svg."""
    with mpl.rc_context({"svg.hashsalt": "steering", "svg.fonttype": "none"}):
        for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
            with replacing(path.with_suffix(f".{kind}")) as unfinished:
                figure.savefig(unfinished, format=kind, dpi=110, metadata=metadata)
