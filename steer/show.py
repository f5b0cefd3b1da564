"""steer show: print a file of a stage, or one of its frames."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base.errors import InputError
from steer import options


def show(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="a drive's .h5 file of any stage, or a checkpoint")],
    frame: Annotated[int | None, typer.Option(min=0, help="print the numbers of this frame")] = None,
    out: Annotated[Path | None, typer.Option(metavar="PNG", help="draw the frame's images and points, too")] = None,
    debug: options.Debug = False,
) -> None:
    """Print a file's attributes, datasets and settings, or one of its frames.

    \b
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5 --frame 20 --out frame.png
    steer show data/train/sa-gnn-ncp/best.pt
    """
    import yaml

    from pipeline.base.outputs import check_free
    from pipeline.show import artefact

    if out and (frame is None or out.suffix != ".png"):
        raise InputError("expected --frame and the name of a PNG file", "--out")
    if out:
        check_free(out)
    content = artefact.describe(path) if frame is None else artefact.frame(path, frame, out)
    print(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110).rstrip())
