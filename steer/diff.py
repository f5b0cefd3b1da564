"""steer diff: compare two artefacts."""

from pathlib import Path
from typing import Annotated

import typer

from steer.options import Debug, Json, Output, Quiet

DIFFERENT = 3  # exit status; 1 is an error, 2 a wrong option
_MAX_LINES = 20  # per file


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="a file or folder of any stage")],
    b: Annotated[Path, typer.Argument(metavar="B", help="another one of the same kind")],
    tolerance: Annotated[
        float, typer.Option(min=0, help="numbers that differ by at most this are equal, in the dataset's unit")
    ] = 0.0,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Compare two artefacts and print what differs: dataset, first frame, number of frames, largest difference.

    HDF5 files are compared by frame, JSON files and checkpoints by key, others by bytes.

    Exit status: 0 equal, 3 different, 1 error, 2 wrong option.

    \b
    steer diff data/labels ../other/data/labels
    steer diff data/train/net/best.pt best.pt --tolerance 1e-6
    """
    from rich.progress import track

    from pipeline.inspect import diff as artefacts

    output = Output(quiet, as_json)
    files = artefacts.pairs(a, b)
    different, found = 0, []
    hidden = not output.console.is_terminal
    for name, one, other in track(files, "comparing", transient=True, console=output.console, disable=hidden):
        differences = list(artefacts.compare(name, one, other, tolerance))
        different += bool(differences)
        found += differences
        for difference in differences[:_MAX_LINES]:
            output.line(str(difference))
        if len(differences) > _MAX_LINES:
            output.line(f"{name}: {len(differences) - _MAX_LINES} more, see --json")
    within = f" (tolerance {tolerance:g})" if tolerance else ""
    output.line(f"files that differ: {different} of {len(files)}{within}" if different else f"equal{within}")
    result = {"equal": not different, "files": len(files), "different": different, "differences": found}
    output.result(result)
    if different:
        raise typer.Exit(DIFFERENT)
