"""What is there, what is missing, and what to do: of a KITTI raw folder and of the project that reads it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.base.errors import InputError, closest
from pipeline.base.executors import default_workers
from pipeline.base.params import load
from pipeline.inspect import forecast, raw_check, raw_listing, stages_due
from pipeline.inspect.forecast import Forecast
from pipeline.inspect.phrases import size
from pipeline.inspect.raw_check import DriveCheck
from pipeline.sections.ingest import Ingest

_ALL_CAMERAS = (2, 0, 3, 1)
_SCAN_POINT_B = 16


@dataclass
class Project:
    """What a project's run needs: why each stage is due, its forecast, hours and bytes; what must be done."""

    folder: Path
    ingest: Ingest | None = None
    due: dict[str, str] = field(default_factory=dict)
    beyond: list[str] = field(default_factory=list)  # due, but no model of params.yaml needs them
    hours: float = 0.0
    cores: int = 1
    written: float = 0.0
    free: int = 0
    must: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def kitti_drives(self) -> list[str]:
        """Return the drives that params.yaml takes from KITTI raw."""
        sources = self.ingest.sources() if self.ingest else {}
        return [drive for drive, source in sources.items() if source == "kitti"]


def of_project(folder: Path) -> Project:
    """Read a project's ``ingest``; what is wrong with its params.yaml is something that must be done."""
    project = Project(folder, cores=default_workers(), free=forecast.free_bytes(folder))
    try:
        project.ingest = load(Ingest, folder / "params.yaml")
    except InputError as error:
        project.must.append(str(error))
    return project


def of_raw(
    root: Path, project: Project | None, deep: bool, done: Callable[[int], object] = lambda drives: None
) -> list[DriveCheck]:
    """Check all drives below a KITTI raw folder, several at a time; `done` hears of each.

    Raises InputError if there are none.
    """
    folders = [root] if raw_listing.is_drive(root) else raw_listing.drives_below(root)
    if not folders:
        raise InputError(f"{root} holds no drives: KITTI raw's layout is <date>/<date>_drive_NNNN_sync{_inside(root)}")
    ingest = project.ingest if project else None
    cameras: Sequence[int] = ingest.cameras if ingest else _ALL_CAMERAS

    def one(folder: Path) -> DriveCheck:
        result = raw_check.check(folder, cameras, ingest.lidar if ingest else True, deep)
        done(1)
        return result

    with ThreadPoolExecutor(default_workers()) as pool:  # disks answer several at a time, and decoders work so
        return list(pool.map(one, folders))


def _inside(root: Path) -> str:
    folders = sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    near = [path for path in folders if raw_listing.drives_below(path)]
    return f". {near[0]} does: give that" if near else ""


def not_there(project: Project, root: Path | None, drives: Sequence[DriveCheck]) -> list[str]:
    """Return what must be done about drives that params.yaml names and nobody finds."""
    named, known = project.kitti_drives(), [drive.drive for drive in drives]
    if named and root is None:
        raw = project.folder / "data" / "raw"
        return [
            f"{raw} is missing, and params.yaml names {len(named)} drives of it. Link it: ln -s /path/to/kitti {raw}"
        ]
    lacking = [drive for drive in named if drive not in known]
    return [f"params.yaml names {drive}, which {root} lacks: {closest(drive, known)}" for drive in lacking]


def plan(project: Project, drives: Sequence[DriveCheck]) -> None:
    """Fill in which stages are due, how long they take and what they write; what hinders goes to `must`."""
    scans = sorted(
        one.modalities["velodyne_points"]["bytes"] // one.modalities["velodyne_points"]["files"] // _SCAN_POINT_B
        for one in drives
        if one.modalities.get("velodyne_points", {}).get("files")
    )
    try:
        foreseen = forecast.forecast(
            project.folder / "params.yaml",
            {one.drive: one.frames for one in drives},
            scans[len(scans) // 2] if scans else 0,
        )
    except InputError as error:
        project.must += [str(error)] * (str(error) not in project.must)
        return
    at_work = stages_due.busy(project.folder)
    if at_work:
        project.notes.append(f"DVC runs a stage here now ({at_work}): ask again when it is done which stage has to run")
        return
    try:
        due = stages_due.due(project.folder)
    except InputError as error:
        project.must.append(str(error))
        _foresee(project, foreseen, foreseen.seconds)
        return
    project.due = {stage: why for stage, why in due.items() if stage in foreseen.seconds}
    project.beyond = [stage for stage in due if stage not in foreseen.seconds]
    _foresee(project, foreseen, project.due)


def _foresee(project: Project, foreseen: Forecast, stages: Iterable[str]) -> None:
    stages = list(stages)
    project.hours = foreseen.hours(stages, project.cores)
    project.written = sum(foreseen.bytes.get(stage, 0.0) for stage in stages)
    needed = project.written - forecast.present_bytes(project.folder / "data", stages)
    if project.free < needed:
        project.must.append(
            f"the disk under {project.folder} has {size(project.free)} free, and the run needs some {size(needed)} "
            "more (estimate): free some space, or put data/ elsewhere"
        )


def what_to_do(drives: Sequence[DriveCheck], named: Sequence[str] | None) -> Mapping[str, list[str]]:
    """Return drive → what must be done about it; of drives that params.yaml does not name (None: any) nothing must."""
    return {one.drive: one.must for one in drives if one.must and (named is None or one.drive in named)}
