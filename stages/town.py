"""The embedded sample: a procedural street world in KITTI raw's layout, so that everything runs without KITTI.

With town.replay it is built along the tracks of real drives, of which only oxts is needed.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.base import console
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.kitti.raw import RawDrive, find_drives
from pipeline.sections.ingest import Ingest
from pipeline.sections.town import Town
from pipeline.town.contact_sheet import contact_sheet, write_rgb
from pipeline.town.drive import Drive
from pipeline.town.layout import read_views
from pipeline.town.rig import make_rig, write_calibration


def main(
    out: Path = Path("data/town"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Render those drives of section ingest that come from the sample; with ingest.source kitti, none.

    Returns the folder that it wrote. Raises InputError where it would replace a drive that it has not rendered.
    """
    settings, ingest = load(Town, params), load(Ingest, params)
    sources = ingest.sources()
    splits = {drive: split for drive, split in ingest.drives.splits().items() if sources[drive] == "town"}
    if not splits:
        out.mkdir(parents=True, exist_ok=True)
        print(f"nothing to render: ingest.source is {ingest.source}, and no drive of ingest.drives is the sample's")
        return out
    folders = {drive: out / drive[:10] / f"{drive}_sync" for drive in splits}
    for folder in folders.values():
        if folder.is_dir() and not (folder / "truth").is_dir():
            raise InputError(f"{folder} is there and is not of the sample: name another --out, or move it away")
    recorded = find_recorded(settings, list(splits))
    frames = {drive: most(drive, splits, settings) for drive in splits}
    frames |= {drive: min(len(raw.oxts), frames[drive]) for drive, raw in recorded.items()}

    def key(drive: str) -> str:
        inputs = [splits[drive], *([recorded[drive].fingerprint([])] if recorded else [])]
        return stage_key("town", {"drive": drive, **settings.model_dump(mode="json")}, inputs)

    run_over_drives(
        partial(_render, splits=splits, settings=settings),
        list(splits),
        out=out,
        key=key,
        frames=frames.__getitem__,
        workers=workers,
        target=folders.__getitem__,
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


def most(drive: str, splits: Mapping[str, str], settings: Town) -> int:
    """Return how many frames a drive of its split has at most."""
    frames: int = getattr(settings.frames, splits[drive])
    return frames


def _render(drive: str, path: Path, *, splits: Mapping[str, str], settings: Town) -> Summary:
    """Write a drive into the folder `path`."""
    laid_out = Drive(
        drive,
        frames=most(drive, splits, settings),
        size=settings.image_size,
        scan_rays=settings.scan_rays,
        seed=settings.seed,
        recorded=find_recorded(settings, [drive]).get(drive),
    )
    with replacing(path) as folder:
        laid_out.write(folder)
    return laid_out.summary()


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    return "{frames} frames, {metres} m, mean squared steering {mean_steering_squared_rad2} rad²".format_map(summary)


if __name__ == "__main__":
    console.run(main)
