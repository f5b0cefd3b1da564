"""steer show and diff: describe an artefact, compare two of them."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base.errors import InputError
from steer import options

DIFFERENT = 3  # exit status; 1 is an error, 2 a wrong option
_MAX_LINES = 20  # per file


def show(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="a drive's .h5 file of any stage, or a checkpoint")],
    frame: Annotated[int | None, typer.Option(min=0, help="print the numbers of this frame")] = None,
    out: Annotated[Path | None, typer.Option(metavar="PNG", help="draw the frame's images and points, too")] = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Print a file's attributes, datasets and settings, or one of its frames.

    \b
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5
    steer show data/graphs/semantic/2026_01_10_drive_0004.h5 --frame 20 --out frame.png
    steer show data/train/sa-gnn-ncp/best.pt --json
    """
    import yaml

    from pipeline.base.outputs import check_free
    from pipeline.show import artefact

    output = options.Output(quiet, as_json)
    if out and (frame is None or out.suffix != ".png"):
        raise InputError("expected --frame and the name of a PNG file", "--out")
    if out:
        check_free(out)
    content = artefact.describe(path) if frame is None else artefact.frame(path, frame, out)
    output.line(
        yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110).rstrip()
    )
    output.result({"path": str(path), **content})


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
