"""Draw a few frames of drives with their perception: data/pictures/<drive>.png."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.params import load
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
    """Draw image, depth, classes and cloud of frames that are evenly spread over each drive. Returns `out`."""
    settings = load(Pictures, params)
    splits = store.read_index(clouds, stage="clouds")
    counts = {drive: getattr(settings.frames, split) for drive, split in splits.items()}
    drawn = [drive for drive in splits if counts[drive]]
    with_images = [drive for drive in drawn if store.frame_count(perception / f"{drive}.h5", stage="perception")]

    run_over_drives(
        partial(_draw, ingest=ingest, perception=perception, clouds=clouds, splits=splits, counts=counts),
        with_images,
        out=out,
        stage="pictures",
        settings=settings.model_dump(mode="json"),
        inputs=lambda drive: [splits[drive], *(folder / f"{drive}.h5" for folder in (ingest, perception, clouds))],
        workers=workers,
        target=lambda drive: out / f"{drive}.png",
        describe=lambda summary: f"frames {', '.join(map(str, summary['drawn']))}",
    )
    without = [drive for drive in drawn if drive not in with_images]
    if without:
        print(f"no pictures of drives without images: {', '.join(without)}", flush=True)
    return out


def _draw(
    drive: str,
    path: Path,
    *,
    ingest: Path,
    perception: Path,
    clouds: Path,
    splits: dict[str, str],
    counts: dict[str, int],
) -> Summary:
    from pipeline.drawing import figure_file, street_view

    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as images,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
        store.DriveReader(clouds / f"{drive}.h5", stage="clouds") as cloud,
    ):
        numbers = street_view.evenly_spread(perceived.frame, counts[drive])
        views = [street_view.read_view(images, perceived, cloud, number) for number in numbers]
    figure_file.save(street_view.sheet(f"{drive} ({splits[drive]})", views), path, dpi=90)
    return {"drawn": numbers}


if __name__ == "__main__":
    console.run(main)
