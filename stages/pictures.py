"""Stage pictures: what became of a few frames of each drive, for people to look at: data/pictures/<drive>.png."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.sections.pictures import Pictures


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    clouds: Path = Path("data/clouds/pseudo"),
    out: Path = Path("data/pictures"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Draw image, depth, classes and cloud from above of frames that are evenly spread over their drive.

    Returns the folder that it wrote.
    """
    settings = load(Pictures, params)
    splits = store.read_index(clouds, stage="clouds")
    pictured = [drive for drive in splits if _frames(perception / f"{drive}.h5")]

    def key(drive: str) -> str:
        inputs: list[Path | str] = [splits[drive], *(folder / f"{drive}.h5" for folder in (ingest, perception, clouds))]
        return stage_key("pictures", {"drive": drive, **settings.model_dump(mode="json")}, inputs)

    run_over_drives(
        partial(_draw, ingest=ingest, perception=perception, clouds=clouds, splits=splits, frames=settings.frames),
        pictured,
        out=out,
        key=key,
        workers=workers,
        target=lambda drive: out / f"{drive}.png",
        describe=lambda summary: f"frames {', '.join(map(str, summary['shown']))}",
    )
    blind = [drive for drive in splits if drive not in pictured]
    if blind:
        print(f"without images, so without pictures: {', '.join(blind)}", flush=True)
    return out


def _draw(
    drive: str, path: Path, *, ingest: Path, perception: Path, clouds: Path, splits: dict[str, str], frames: int
) -> Summary:
    from pipeline.report.street_view import draw_sheet, evenly_spread, read_view

    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveReader(clouds / f"{drive}.h5", stage="clouds") as cloud,
    ):
        numbers = evenly_spread(perceived.frame, frames)
        views = [read_view(raw, perceived, cloud, number) for number in numbers]
    draw_sheet(path, f"{drive} ({splits[drive]})", views)
    return {"shown": numbers}


def _frames(path: Path) -> int:
    with store.DriveReader(path, stage="perception") as perceived:
        return len(perceived.frame)


if __name__ == "__main__":
    console.run(main)
