"""Declare the arguments that several commands share, beside the options of a recording."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from steer.outcome import Outcome

SourcePath = Annotated[
    list[Path],
    typer.Argument(
        metavar="SOURCE...",
        help="folder of a KITTI drive, of images or of videos, or videos in order",
    ),
]
Out = Annotated[
    Path | None, typer.Option(help="new or empty folder for the results; default: out/SOURCE")
]
Video = Annotated[bool, typer.Option(help="write overlay.mp4")]


def run(
    function: Callable[..., "Outcome"], source: list[Path], out: Path | None, **options: Any
) -> None:
    """Call a function of `steer.api` with a free folder. Print notes, files and three doubts."""
    from pipeline.base.outputs import claimed

    with claimed(out, source[0].resolve().stem.removesuffix("_sync")) as folder:
        outcome = function(source, out=folder, **options)
    files = ", ".join(str(path) for path in outcome.files)
    print(*outcome.notes, files, sep="\n")
    for text in outcome.doubts[:3]:
        print(f"doubt: {text}")
