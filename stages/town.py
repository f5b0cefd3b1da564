"""The embedded sample: a procedural street world in KITTI raw's layout, so that everything runs without KITTI.

With town.replay it is built along the tracks of real drives, of which only oxts is needed.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.pool import run_over_drives
from pipeline.kitti.raw import RawDrive, find_drives
from pipeline.sections.ingest import Ingest
from pipeline.sections.town import Town
from pipeline.town.contact_sheet import contact_sheet, write_rgb
from pipeline.town.drive import write_drive
from pipeline.town.layout import read_views
from pipeline.town.rig import make_rig, write_calibration


def main(
    out: Path = Path("data/town"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Render the drives that section ingest names; with ingest.source kitti, nothing.

    Returns the folder that it wrote. Raises InputError where it would replace a drive that it has not rendered.
    """
    settings, ingest = load(Town, params), load(Ingest, params)
    if ingest.source == "kitti":
        out.mkdir(parents=True, exist_ok=True)
        print("nothing to render: ingest.source is kitti")
        return out
    splits = ingest.drives.splits()
    folders = {drive: out / drive[:10] / f"{drive}_sync" for drive in splits}
    for folder in folders.values():
        if folder.is_dir() and not (folder / "truth").is_dir():
            raise InputError(f"{folder} is there and is not of the sample: name another --out, or move it away")
    recorded = find_recorded(settings, list(splits))
    frames = {drive: getattr(settings.frames, split) for drive, split in splits.items()}
    frames |= {drive: min(frames[drive], len(raw.oxts)) for drive, raw in recorded.items()}
    run_over_drives(
        partial(render, splits=splits, settings=settings),
        list(splits),
        module="stages.town",
        out=out,
        inputs=lambda drive: [splits[drive], *([recorded[drive].fingerprint([])] if recorded else [])],
        settings=settings.model_dump(),
        workers=workers,
        target=folders.__getitem__,
        effort=frames.__getitem__,
        describe=describe,
    )
    for date in sorted({folder.parent for folder in folders.values()}):
        write_calibration(make_rig(settings.image_size, date.name), date)
    write_rgb(out / "contact_sheet.png", contact_sheet(read_views(list(folders.values()), count=7)))
    return out


def find_recorded(settings: Town, drives: Sequence[str]) -> dict[str, RawDrive]:
    """Return the real drives to drive along; none without town.replay."""
    if settings.replay is None:
        return {}
    root = Path(settings.replay)
    if not root.is_dir():
        raise InputError(f"town.replay = {root} is missing. Link it: ln -s /path/to/kitti {root}")
    return find_drives(root, drives)


def render(drive: str, path: Path, splits: Mapping[str, str], settings: Town) -> dict[str, Any]:
    """Write one drive's folder; its length depends on its split."""
    return write_drive(
        drive,
        path,
        frames=getattr(settings.frames, splits[drive]),
        size=settings.image_size,
        scan_rays=settings.scan_rays,
        seed=settings.seed,
        recorded=find_recorded(settings, [drive]).get(drive),
    )


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    return "{frames} frames, {metres} m, mean squared steering {mean_steering_squared_rad2} rad²".format_map(summary)


if __name__ == "__main__":
    console.run(main)
