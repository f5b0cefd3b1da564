"""steer diff: whether two artefacts are equal, and where they differ."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from steer.options import Debug, Json, Quiet, Voice

DIFFERENT = 3  # exit status; 1 is an error, 2 a wrong option, as with every command here
_MOST = 20  # lines on one file


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="a file or folder of any stage")],
    b: Annotated[Path, typer.Argument(metavar="B", help="one of the same kind")],
    tolerance: Annotated[
        float, typer.Option(min=0, help="numbers that differ by no more are equal; in each dataset's own unit")
    ] = 0.0,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Compare two artefacts: where they differ by drive, frame and dataset, how many values, by how much at most.

    HDF5 files are matched by frame number, CSV files by drive and frame, JSON and checkpoints by key; others as bytes.
    Of HDF5 files some MB are in memory at a time, however large they are.

    Exit status: 0 equal, 3 different, 1 an error, 2 a wrong option.

    steer diff data/labels ../other/data/labels

    steer diff data/train/net/best.pt best.pt --tolerance 1e-6
    """
    from tqdm import tqdm

    from pipeline.inspect.compare import artefacts

    voice = Voice(quiet, as_json)
    files = artefacts.pairs(a, b)
    differ, found = 0, []
    bar = tqdm(files, unit=" files", leave=False, disable=None if voice.talks and len(files) > 1 else True)
    for name, one, other in bar:
        differences = list(artefacts.compare(name, one, other, tolerance))
        differ += bool(differences)
        found += differences if as_json else []
        for difference in differences[:_MOST]:
            tqdm.write(str(difference), file=sys.stdout) if voice.talks else None
        if len(differences) > _MOST:
            voice.line(f"{name}: and {len(differences) - _MOST} more; --json has all")
    within = f" (tolerance {tolerance:g})" if tolerance else ""
    voice.line(f"{differ} of {len(files)} files differ{within}" if differ else f"equal: {len(files)} files{within}")
    voice.result(
        {"equal": not differ, "files": len(files), "different": differ, "differences": [asdict(each) for each in found]}
    )
    if differ:
        raise typer.Exit(DIFFERENT)
