"""steer show and diff: describe an artefact, compare two of them."""

from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer import options

DIFFERENT = 3  # exit status; 1 is an error, 2 a wrong option
_MAX_LINES = 20  # per file


def show(
    path: Annotated[Path, typer.Argument(metavar="FILE_OR_FOLDER", help="artefact of a stage")],
    frame: Annotated[int | None, typer.Option(min=0, help="print and draw only this frame")] = None,
    out: Annotated[Path | None, typer.Option(help="name of the PNG file; default: NAME-frame-N.png")] = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Describe an artefact, or draw one of its frames.

    \b
    steer show data
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5 --frame 20
    steer show data/train/sa-gnn-ncp --json
    """
    from pipeline.show import artefact

    output = options.Output(quiet, as_json)
    if frame is not None or out:
        output.result(_show_frame(path, frame, out, output))
        return
    content = artefact.describe(path)
    output.facts(content)
    output.result(content)


def _show_frame(path: Path, frame: int | None, out: Path | None, output: options.Output) -> dict[str, Any]:
    """Print a frame's numbers, draw it, and return what was written."""
    from pipeline.show import frame_view

    options.check_names(path, out)
    if out and out.suffix.lower() != ".png":
        raise InputError(f"expected the name of a PNG file, got {out}", "--out")
    view, numbers = frame_view.read(path, frame)
    title = f"{Path(*path.absolute().parts[-3:])}, frame {view.frame}"
    content: dict[str, Any] = {"path": str(path), "frame": view.frame, **numbers}
    if out or frame_view.is_drawable(view):
        picture = out or Path(f"{path.absolute().stem}-frame-{view.frame}.png")
        frame_view.draw(picture, title, view)
        content["picture"] = str(picture)
    output.facts(content)
    return content


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="file or folder of any stage")],
    b: Annotated[Path, typer.Argument(metavar="B", help="file or folder of the same kind")],
    tolerance: Annotated[
        float, options.number(0, None, "numbers that differ by at most this are equal, in the dataset's unit")
    ] = 0.0,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Compare two artefacts and print the differences.

    HDF5 files are compared frame by frame (dataset, first frame, number of frames, largest difference), JSON files and
    checkpoints by key, other files by bytes. Exit status: 0 equal, 3 different, 1 error, 2 wrong option.

    \b
    steer diff data/labels ../other/data/labels
    steer diff data/train/net/best.pt best.pt --tolerance 1e-6
    """
    from rich.progress import track

    from pipeline.show.diff import compare, pairs

    output = options.Output(quiet, as_json)
    files = pairs(a, b)
    different, differences = 0, []
    hidden = not output.console.is_terminal
    for name, file_a, file_b in track(files, "comparing", transient=True, console=output.console, disable=hidden):
        in_file = list(compare(name, file_a, file_b, tolerance))
        different += bool(in_file)
        differences += in_file
        for difference in in_file[:_MAX_LINES]:
            output.line(str(difference))
        if len(in_file) > _MAX_LINES:
            output.line(f"{name}: {len(in_file) - _MAX_LINES} more, see --json")
    within = f" (tolerance {tolerance:g})" if tolerance else ""
    output.line(f"files that differ: {different} of {len(files)}{within}" if different else f"equal{within}")
    counts = {"equal": not different, "files": len(files), "different": different}
    output.result(counts | {"differences": differences})
    if different:
        raise typer.Exit(DIFFERENT)
