"""Draw a few frames of drives with their perception: data/pictures/<drive>.png."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.params import load
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.settings.pictures import Pictures


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
    with_images = [drive for drive in drawn if _has_images(perception / f"{drive}.h5")]
    jobs = [
        Job(
            drive,
            out / f"{drive}.png",
            [splits[drive], *(folder / f"{drive}.h5" for folder in (ingest, perception, clouds))],
            partial(
                _draw,
                title=f"{drive} ({splits[drive]})",
                files=[folder / f"{drive}.h5" for folder in (ingest, perception, clouds)],
                count=counts[drive],
            ),
        )
        for drive in with_images
    ]
    with run_over_drives("pictures", settings, jobs, out, "frames {drawn}".format_map, workers=workers):
        without = [drive for drive in drawn if drive not in with_images]
        if without:
            print(f"no pictures of drives without images: {', '.join(without)}", flush=True)
    return out


def _has_images(path: Path) -> bool:
    with store.DriveReader(path, stage="perception") as perceived:
        return len(perceived.frame) > 0


def _draw(path: Path, *, title: str, files: Sequence[Path], count: int) -> Summary:
    from pipeline.drawing import figure_file, street_view

    with (
        store.DriveReader(files[0], stage="ingest") as images,
        store.DriveReader(files[1], stage="perception") as perceived,
        store.DriveReader(files[2], stage="clouds") as cloud,
    ):
        numbers = street_view.evenly_spread(perceived.frame, count)
        views = [street_view.read_view(images, perceived, cloud, number) for number in numbers]
    figure_file.save(street_view.sheet(title, views), path, dpi=90)
    return {"drawn": ", ".join(map(str, numbers))}


if __name__ == "__main__":
    console.run(main)
