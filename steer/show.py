"""steer show: describe an artefact, trace its origin, and draw a frame."""

from pathlib import Path
from typing import Annotated, Any

import typer

from steer.options import Debug, Json, Output, Quiet


def show(
    path: Annotated[Path, typer.Argument(metavar="FILE_OR_FOLDER", help="an artefact of a stage")],
    frame: Annotated[int | None, typer.Option(min=0, help="show this frame only, and draw it")] = None,
    out: Annotated[Path | None, typer.Option(help="name of the PNG; default NAME-frame-N.png")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Describe an artefact of any stage, and the stage that wrote it; or draw one of its frames.

    \b
    steer show data
    steer show data/graphs/semantic/2026_01_03_drive_0001.h5
    steer show data/graphs/semantic/2026_01_03_drive_0001.h5 --frame 40
    steer show data/train/sa-gnn-ncp --json
    """
    from pipeline.inspect import artefact, project

    output = Output(quiet, as_json)
    if frame is not None or out:
        output.result(_show_frame(path, frame, out, output))
        return
    content = artefact.describe(path)
    origin = project.trace(path)
    output.facts(content)
    output.facts(origin)
    output.result(content | {"origin": origin})


def _show_frame(path: Path, frame: int | None, out: Path | None, output: Output) -> dict[str, Any]:
    """Print a frame's numbers, draw it, and return what was written."""
    from pipeline.inspect import frame_view

    view = frame_view.read(path, frame)
    title = f"{Path(*path.absolute().parts[-3:])}, frame {view.frame}"
    content: dict[str, Any] = {"path": str(path), "frame": view.frame, **view.values}
    if out or view.drawable:
        picture = out or Path(f"{path.absolute().stem}-frame-{view.frame}.png")
        frame_view.draw(picture, title, view)
        content["picture"] = str(picture)
    output.facts(content)
    return content
