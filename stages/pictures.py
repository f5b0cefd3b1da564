"""Stage pictures: what became of a few frames of each drive, for people to look at: data/pictures/<drive>.png."""

from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, store
from pipeline.base import pool as drives
from pipeline.base.params import load
from pipeline.sections.pictures import Pictures


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    clouds: Path = Path("data/clouds/pseudo"),
    out: Path = Path("data/pictures"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> None:
    """Draw image, depth, classes and cloud from above of frames that are evenly spread over their drive."""
    section = load(Pictures, params)
    splits = store.read_index(clouds, stage="clouds")
    seen = [drive for drive in splits if _frames(perception / f"{drive}.h5")]
    drives.run_over_drives(
        partial(_draw, ingest=ingest, perception=perception, clouds=clouds, splits=splits, frames=section.frames),
        seen,
        module="stages.pictures",
        out=out,
        inputs=lambda drive: [splits[drive], *(folder / f"{drive}.h5" for folder in (ingest, perception, clouds))],
        settings=section.model_dump(),
        workers=workers,
        target=lambda drive: out / f"{drive}.png",
        describe=lambda summary: f"frames {', '.join(map(str, summary['shown']))}",
    )
    blind = [drive for drive in splits if drive not in seen]
    if blind:
        print(f"without images, so without pictures: {', '.join(blind)}", flush=True)


def _draw(
    drive: str, path: Path, *, ingest: Path, perception: Path, clouds: Path, splits: dict[str, str], frames: int
) -> drives.Summary:
    from pipeline.report.street_view import read_view, sheet

    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as seen,
        store.DriveReader(clouds / f"{drive}.h5", stage="clouds") as cloud,
    ):
        count = min(frames, len(seen.frame))
        middles = (2 * np.arange(count) + 1) * len(seen.frame) // (2 * count)  # of `count` equal parts of the drive
        views = [read_view(raw, seen, cloud, int(number)) for number in seen.frame[middles]]
    tmp = path.with_name(path.name + ".tmp")
    figure = sheet(f"{drive} ({splits[drive]})", views)
    figure.savefig(tmp, format="png", dpi=90, metadata={"Software": None})
    tmp.replace(path)
    return {"shown": [view.frame for view in views]}


def _frames(path: Path) -> int:
    with store.DriveReader(path, stage="perception") as seen:
        return len(seen.frame)


if __name__ == "__main__":
    console.run(main)
