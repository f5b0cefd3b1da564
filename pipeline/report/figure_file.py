"""Write matplotlib figures as PNG files: the same figure gives the same bytes."""

from pathlib import Path

from matplotlib.figure import Figure

from pipeline.base.atomic import replacing


def save(figure: Figure, path: Path, dpi: int = 110) -> None:
    """Write `figure` to a PNG file in one step, without a version number in it."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, format="png", dpi=dpi, metadata={"Software": "semantic-steering"})
