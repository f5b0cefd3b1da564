"""steer doctor: what is there, what is missing or damaged, and what a run will take."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steer.options import Debug, Json, Quiet, Voice

if TYPE_CHECKING:
    from pipeline.inspect.checkup import Project
    from pipeline.inspect.raw_check import DriveCheck


def doctor(
    root: Annotated[
        Path | None, typer.Argument(metavar="KITTI_ROOT", help="a KITTI raw folder; default: data/raw of the project")
    ] = None,
    deep: Annotated[
        bool, typer.Option("--deep", help="decode every image and scan: minutes instead of seconds")
    ] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """What is missing or damaged, which labels are implausible, which stage has to run, and how long that takes.

    Ends with status 0 if all is well, with 1 if something must be done; what is wrong with drives that params.yaml
    does not name is only told. Times and sizes to come are estimates from measured rates.

        steer doctor

        steer doctor ~/kitti --deep

        steer doctor data/raw --json
    """
    from pipeline.inspect import checkup, lineage

    voice = Voice(quiet, as_json)
    folder = lineage.project_of(Path.cwd())
    project = checkup.of_project(folder) if folder else None
    if root is None and folder and (folder / "data" / "raw").is_dir():
        root = folder / "data" / "raw"
    if root is None and folder is None:
        raise _nothing_to_check()
    drives = _check(root, project, deep, voice) if root else []
    named = project.kitti_drives() if project and project.ingest else None
    due = checkup.what_to_do(drives, named or None)
    lacking = checkup.not_there(project, root, drives) if project else []
    if project:
        checkup.plan(project, drives)
    advice = {one.drive: one.advice() for one in drives if one.drive in due and one.extract}
    must = [f"{drive}: {fault}" for drive, faults in due.items() for fault in faults] + lacking
    must += project.must if project else []
    if project and project.due:
        count = len(project.due)
        must.append(f"{count} stage{' has' if count == 1 else 's have'} to run: dvc repro check pictures report")
    for line in _lines(root, drives, set(due), project):
        voice.line(line)
    for line in _to_do(must, advice):
        voice.line(line)
    voice.result(_as_json(root, drives, project, must, advice))
    if must:
        raise typer.Exit(1)


def _nothing_to_check() -> Exception:
    from pipeline.base.errors import InputError

    return InputError(
        "there is no project here: run from its folder, or give a KITTI raw folder: steer doctor KITTI_ROOT"
    )


def _check(root: Path, project: "Project | None", deep: bool, voice: Voice) -> "list[DriveCheck]":
    from tqdm import tqdm

    from pipeline.inspect import checkup

    with tqdm(unit=" drives", disable=not (voice.talks and sys.stderr.isatty()), leave=False) as bar:
        return checkup.of_raw(root, project, deep, bar.update)


def _lines(
    root: Path | None, drives: "Sequence[DriveCheck]", due: set[str], project: "Project | None"
) -> Iterator[str]:
    from pipeline.inspect.phrases import many, table

    if root:
        yield f"{root}: {many(len(drives), 'drive')}, {sum(one.frames for one in drives)} packets"
        names = list(dict.fromkeys(name for one in drives for name in one.modalities))
        rows = [("drive", *names, "timestamps", "calibration", "")]
        for one in drives:
            counts = (str(one.modalities[name]["files"]) if name in one.modalities else "-" for name in names)
            state = "to do, see below" if one.drive in due else "not named, damaged" if one.must else "well"
            stamps = one.modalities["oxts"]["stamps"] or "-"
            rows.append((one.drive, *counts, str(stamps), _in_short(one.calibration), state))
        yield from table(rows)
    notes = [f"{one.drive}: {note}" for one in drives for note in one.notes]
    notes += [
        f"{one.drive}, not named in params.yaml: {fault}"
        for one in drives
        if one.drive not in due
        for fault in one.must
    ]
    notes += project.notes if project else []
    if notes:
        yield from ("worth knowing:", *(f"  {note}" for note in notes))
    if project:
        yield from _run(project)


def _in_short(calibration: Sequence[str]) -> str:
    return ", ".join(name.removeprefix("calib_").removesuffix(".txt") for name in calibration) or "-"


def _to_do(must: Sequence[str], advice: Mapping[str, str]) -> Iterator[str]:
    yield "to do:" if must else "all is well"
    yield from (f"  {one}" for one in must)
    if advice:
        yield "by, where the archives lie (ingest.on_damaged: skip would leave out what stays damaged):"
        yield from (f"  {command}" for command in advice.values())


def _run(project: "Project") -> Iterator[str]:
    from pipeline.inspect.phrases import many, size

    yield f"project {project.folder}: {size(project.free)} free"
    for stage, why in project.due.items():
        yield f"  {stage} has to run: {why}"
    if project.beyond:
        yield f"  not needed by a model of params.yaml: {', '.join(project.beyond)}"
    if project.hours:
        yield (
            f"  estimate, good to a factor of two: {_duration(project.hours)} on {many(project.cores, 'core')} "
            "without a GPU, "
            f"{size(project.written)} in data/, as much again in DVC's cache unless it links"
        )


def _duration(hours: float) -> str:
    return f"{hours * 60:.0f} min" if hours < 2 else f"{hours:.0f} h" if hours < 48 else f"{hours / 24:.0f} days"


def _as_json(
    root: Path | None,
    drives: "Sequence[DriveCheck]",
    project: "Project | None",
    must: Sequence[str],
    advice: Mapping[str, str],
) -> dict[str, Any]:
    told: dict[str, Any] = {"root": str(root) if root else None, "well": not must, "to_do": list(must)}
    told["commands"] = dict(advice)
    told["drives"] = {
        one.drive: {"modalities": one.modalities, "to_do": one.must, "notes": one.notes, "calibration": one.calibration}
        for one in drives
    }
    if project:
        told["project"] = {
            "folder": str(project.folder),
            "due": project.due,
            "not_needed": project.beyond,
            "notes": project.notes,
            "free_bytes": project.free,
            "estimate": {"hours": project.hours, "cores": project.cores, "bytes": project.written},
        }
    return told
