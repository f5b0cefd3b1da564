"""The embedded sample: a procedural street world in KITTI raw's layout, so that everything runs without KITTI.

With town.replay it is built along the tracks of real drives, of which only oxts is needed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.pool import run_over_frames
from pipeline.kitti.raw import RawDrive, find_drives
from pipeline.sections.ingest import Ingest
from pipeline.sections.town import Town
from pipeline.town.contact_sheet import contact_sheet, write_rgb
from pipeline.town.drive import Drive
from pipeline.town.layout import read_views
from pipeline.town.rig import make_rig, write_calibration

BLOCK_FRAMES = 128  # more than elsewhere: a process lays out the drive's street before it renders the first


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
    frames: dict[str, Sequence[int]] = {drive: range(most(drive, splits, settings)) for drive in splits}
    frames |= {drive: list(raw.oxts)[: len(frames[drive])] for drive, raw in recorded.items()}
    run_over_frames(
        Render(splits, settings),
        list(splits),
        frames=lambda drive: frames[drive] or range(1),  # without packets: it says so
        params=None,
        stage="town",
        out=out,
        inputs=lambda drive: [splits[drive], *([recorded[drive].fingerprint([])] if recorded else [])],
        settings=settings.model_dump(),
        workers=workers,
        target=folders.__getitem__,
        block_frames=BLOCK_FRAMES,
        total=lambda blocks: blocks[0],  # each tells of the whole drive
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


@dataclass
class Render:
    """Renders frames of drives; it keeps the last drive's street from one block to the next."""

    splits: Mapping[str, str]
    settings: Town
    laid_out: dict[str, Drive] = field(default_factory=dict)

    def __call__(self, drive: str, rows: range, path: Path) -> dict[str, Any]:
        """Write frames of a drive into the folder `path`, and return what the log says of the whole drive."""
        if drive not in self.laid_out:
            self.laid_out.clear()
            self.laid_out[drive] = Drive(
                drive,
                frames=most(drive, self.splits, self.settings),
                size=self.settings.image_size,
                scan_rays=self.settings.scan_rays,
                seed=self.settings.seed,
                recorded=find_recorded(self.settings, [drive]).get(drive),
            )
        self.laid_out[drive].write(path, rows)
        return self.laid_out[drive].summary()


def describe(summary: Mapping[str, Any]) -> str:
    """Return what the log says of one drive."""
    return "{frames} frames, {metres} m, mean squared steering {mean_steering_squared_rad2} rad²".format_map(summary)


if __name__ == "__main__":
    console.run(main)
