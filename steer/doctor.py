"""steer doctor: check raw drives and the project."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steer import options

if TYPE_CHECKING:
    from pipeline.inspect.project import Project
    from pipeline.inspect.raw_check import DriveCheck

_ALL_CAMERAS = (2, 0, 3, 1)


def doctor(
    root: Annotated[
        Path | None, typer.Argument(metavar="KITTI_ROOT", help="KITTI raw folder; default: the project's data/raw")
    ] = None,
    deep: Annotated[bool, typer.Option("--deep", help="decode every image and scan, which takes minutes")] = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Check raw drives and the project.

    Lists drives that are missing, partly extracted or damaged, and stages that have to run. Problems of drives that
    params.yaml does not name are notes. Exit status: 0 no problems, 1 problems.

    \b
    steer doctor
    steer doctor ~/kitti --deep
    steer doctor data/raw --json
    """
    from pipeline.base.errors import InputError
    from pipeline.inspect import project, raw_check

    output = options.Output(quiet, as_json)
    folder = project.project_root(Path.cwd())
    if root is None and folder is None:
        fix = "Run from the project's folder, or pass a KITTI raw folder: steer doctor KITTI_ROOT"
        raise InputError("no dvc.yaml in this folder or above", Path.cwd(), fix)
    if root is None and folder and (folder / "data" / "raw").is_dir():
        root = folder / "data" / "raw"
    with output.console.status("checking", spinner="line"):
        found = project.check(folder) if folder else None
        cameras, lidar = (found.ingest.cameras, found.ingest.lidar) if found and found.ingest else (_ALL_CAMERAS, True)
        oxts = not found or found.needs_oxts
        drives = raw_check.check_root(root, cameras, lidar, deep, oxts) if root else []
    named = found.kitti_drives() if found else []
    required = [one for one in drives if not named or one.drive in named]
    problems = [f"{one.drive}: {text}" for one in required for text in one.problems]
    notes = [f"{one.drive}: {text}" for one in drives for text in one.notes]
    others = [one for one in drives if one not in required]
    notes += [f"{one.drive}, not in params.yaml: {text}" for one in others for text in one.problems]
    if found:
        problems += _missing_drives(named, root, drives, found) + found.problems
        notes += found.notes
        if found.due:
            problems.append(f"stages that have to run: {len(found.due)}. Run: dvc repro check pictures report")
    fixes = [one.fix for one in required if one.fix]
    _print(output, drives, found, {"problems": problems, "extract again": fixes, "notes": notes})
    names = ("folder", "due", "unused", "free_bytes", "due_bytes")
    state = {name: getattr(found, name) for name in names} if found else None
    lists = {"problems": problems, "commands": fixes, "notes": notes}
    output.result({"root": root, "drives": drives, "project": state, **lists})
    if problems:
        raise typer.Exit(1)


def _missing_drives(
    named: Sequence[str], root: Path | None, drives: "Sequence[DriveCheck]", project: "Project"
) -> list[str]:
    from pipeline.base.errors import closest

    if named and root is None:
        raw = project.folder / "data" / "raw"
        return [f"{raw} is missing, but params.yaml names {len(named)} of its drives. Run: ln -s /path/to/kitti {raw}"]
    present = [one.drive for one in drives]
    missing = [drive for drive in named if drive not in present]
    if not missing:
        return []
    more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
    names = ", ".join(missing[:3]) + more
    return [f"named in params.yaml, missing in {root}: {names} ({closest(missing[0], present)})"]


def _print(
    output: options.Output, drives: "Sequence[DriveCheck]", project: "Project | None", lists: dict[str, list[str]]
) -> None:
    names = dict.fromkeys(name for one in drives for name in one.files)
    if drives:
        output.table([
            {"drive": one.drive} | {name: one.files.get(name) for name in names}
            | {"calibration": one.calibration, "problems": len(one.problems)}
            for one in drives
        ])  # fmt: skip
    if project:
        output.line(f"project {project.folder}: {project.free_bytes / 1e9:.1f} GB free")
        if project.due:
            output.table([{"stage": stage, "has to run because": reason} for stage, reason in project.due.items()])
    for title, texts in lists.items():
        if texts:
            output.line("\n  ".join([f"{title}:", *texts]))
    if not lists["problems"]:
        output.line("no problems found")
