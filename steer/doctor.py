"""steer doctor: check raw drives and the project."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from steer import options

if TYPE_CHECKING:
    from pipeline.show.project import Project
    from pipeline.show.raw_check import DriveCheck

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

    Lists drives that are missing, partly extracted or damaged, and stages that have to run, which is no problem.
    Problems of drives that params.yaml does not name are notes. Exit status: 0 no problems, 1 problems.

    \b
    steer doctor
    steer doctor ~/kitti --deep
    steer doctor data/raw --json
    """
    from pipeline.base.errors import InputError
    from pipeline.show import project as projects
    from pipeline.show import raw_check

    output = options.Output(quiet, as_json)
    folder = projects.project_root(Path.cwd())
    if root is None and folder is None:
        fix = "Run it in the project's folder, or pass a KITTI raw folder: steer doctor KITTI_ROOT"
        raise InputError("no dvc.yaml in this folder or above", Path.cwd(), fix)
    if root is None and folder and (folder / "data" / "raw").is_dir():
        root = folder / "data" / "raw"
    with output.console.status("checking", spinner="line"):
        project = projects.check(folder) if folder else None
        ingest = project.ingest if project else None
        cameras, lidar = (ingest.cameras, ingest.lidar) if ingest else (_ALL_CAMERAS, True)
        drives = raw_check.check_root(root, cameras, lidar, deep, not project or project.needs_oxts) if root else []
    names = project.kitti_drives() if project else []
    used = [check for check in drives if not names or check.drive in names]
    unused = [check for check in drives if check not in used]
    problems = [f"{check.drive}: {text}" for check in used for text in check.problems]
    notes = [f"{check.drive}: {text}" for check in drives for text in check.notes]
    notes += [f"{check.drive}, not in params.yaml: {text}" for check in unused for text in check.problems]
    if project:
        if project.needs_oxts:
            lacking = [check.drive for check in used if check.drive in names and "oxts" not in check.files]
            fix = "Set labels.source to visual or wheel"
            problems += [f"{drive}: no oxts, which labels.source: oxts needs. {fix}" for drive in lacking]
        problems += _missing_drives(names, root, drives, project) + project.problems
        notes += project.notes
    commands = [check.fix for check in used if check.fix]
    _print(output, drives, project, {"problems": problems, "commands": commands, "notes": notes})
    fields = ("folder", "due", "unused", "free_bytes", "due_bytes")
    state = {name: getattr(project, name) for name in fields} if project else None
    lists = {"problems": problems, "commands": commands, "notes": notes}
    output.result({"root": root, "drives": drives, "project": state, **lists})
    if problems:
        raise typer.Exit(1)


def _missing_drives(
    names: Sequence[str], root: Path | None, drives: "Sequence[DriveCheck]", project: "Project"
) -> list[str]:
    """Return a problem if drives of params.yaml, `names`, are missing in `root`."""
    from pipeline.base.errors import closest

    if names and root is None:
        raw = project.folder / "data" / "raw"
        return [f"{raw} is missing, but params.yaml names {len(names)} of its drives. Run: ln -s /path/to/kitti {raw}"]
    present = [check.drive for check in drives]
    missing = [drive for drive in names if drive not in present]
    if not missing:
        return []
    more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
    hint = closest(missing[0], present)
    return [f"named in params.yaml, missing in {root}: {', '.join(missing[:3])}{more} ({hint})"]


def _print(
    output: options.Output, drives: "Sequence[DriveCheck]", project: "Project | None", lists: dict[str, list[str]]
) -> None:
    modalities = dict.fromkeys(name for check in drives for name in check.files)
    if drives:
        output.table([
            {"drive": check.drive} | {name: check.files.get(name) for name in modalities}
            | {"calibration": check.calibration, "problems": len(check.problems)}
            for check in drives
        ])  # fmt: skip
    if project:
        from pipeline.show.project import NOT_RUN

        output.line(f"project {project.folder}: {project.free_bytes / 1e9:.1f} GB free")
        if changed := {stage: reason for stage, reason in project.due.items() if reason != NOT_RUN}:
            output.table([{"stage": stage, "has to run because": reason} for stage, reason in changed.items()])
        if project.due:
            output.line(f"stages that have to run: {len(project.due)}. Run: dvc repro check pictures report")
    for title, texts in lists.items():
        if texts:
            output.line("\n  ".join([f"{title}:", *texts]))
    if not lists["problems"]:
        output.line("no problems found")
