"""Make one graph variant, all that a network sees: data/graphs/<variant>/<drive>.h5."""

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, progress, store
from pipeline.base.errors import InputError, explained
from pipeline.base.params import load_entry
from pipeline.base.pool import Summary, run_over_frames
from pipeline.graphs import accumulate, cloud, graph_file
from pipeline.motion import kinds
from pipeline.sections.graphs import Variant


def main(
    name: Annotated[str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")],
    data: Annotated[Path, typer.Option(help="below it lie the variant's source and motion")] = Path("data"),
    out: Annotated[Path, typer.Option(help="below it, VARIANT is written")] = Path("data/graphs"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Sample each cloud to the variant's number of points and find who neighbours whom; or copy the images.

    Returns the variant's folder.
    """
    settings = load_entry(Variant, "graphs", name, params)
    source, stage = data / settings.source, settings.source.split("/")[0]
    splits = store.read_index(source, stage=stage)
    measured = kinds.read(data / "motion")
    if settings.accumulate and settings.accumulate.motion not in measured:
        raise InputError(
            f"{params}: graphs.{name}.accumulate.motion = {settings.accumulate.motion!r}, but {data / 'motion'} holds "
            f"{', '.join(measured)}: add it to motion.kinds and run dvc repro, or take another"
        )
    summaries = run_over_frames(
        partial(_images if settings.kind == "image" else _points, source=source, motion=measured, settings=settings),
        list(splits),
        stage="graphs",
        params={"graphs": settings.model_dump()},
        frames=lambda drive: _numbers(source / f"{drive}.h5", stage),
        out=out / name,
        resume=out.parent / ".resume" / f"{out.name}-{name}",
        inputs=lambda drive: [folder / f"{drive}.h5" for folder in (source, *measured.values())],
        settings={**settings.model_dump(), "motion": list(measured)},
        workers=workers,
        describe=lambda summary: ", ".join(f"{number} {what}" for what, number in summary.items()),
    )
    if settings.kind != "image":
        crop = settings.crop_m and f"Widen crop_m = {list(settings.crop_m)}: left, near, right, far in metres"
        with explained(
            f"{params}: graphs.{name}", hint=crop or f"{source} has none: dvc repro --force --single-item clouds"
        ):
            cloud.check_any(summaries, splits)
    store.write_index(out / name, splits)
    before, after = (sum(summary.get(key, 0) for summary in summaries.values()) for key in ("kNN edges", "kept"))
    if before:
        print(f"{name}: {after / before:.0%} of {before} kNN edges kept")
    empty = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if empty:
        print(f"{name}: no frames in {', '.join(empty)} (nothing to make them from)")
    return out / name


def _numbers(source: Path, stage: str) -> list[int]:
    """Return the numbers of the frames that a drive's graph file is made of."""
    with store.DriveReader(source, stage=stage) as file:
        numbers = file.frame[file["has_image"] > 0] if stage == "ingest" else file.frame
        return [int(number) for number in numbers]


def _points(
    drive: str, rows: range, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], settings: Variant
) -> Summary:
    assert settings.points  # as every variant of points has
    neighbours: graph_file.Neighbours
    if settings.kind == "graph":
        assert settings.k
        neighbours = graph_file.KnnGraph(settings.points, settings.k, settings.keep_inter_class)
    else:
        neighbours = graph_file.PointSets(settings.points, settings.levels)
    with store.DriveReader(source / f"{drive}.h5", stage="clouds") as clouds:
        frame, wholes = clouds.frame[rows], _clouds(clouds, rows)
        if settings.accumulate:
            with store.DriveReader(motion[settings.accumulate.motion] / f"{drive}.h5", stage="motion") as measured:
                T_before = accumulate.steps(measured, settings.source)
            most = settings.accumulate.frames
            seen = range(max(0, rows.start - most + 1), rows.stop)  # with those before the block that reach into it
            spanning = accumulate.accumulated(clouds.frame[seen].tolist(), _clouds(clouds, seen), T_before, most)
            wholes = islice(spanning, rows.start - seen.start, None)
        frames = progress.counted(_frames(drive, frame, wholes, settings, settings.points))
        counts = graph_file.write_points(file, frame, clouds.time_s[rows], frames, neighbours)
        _put_motion(file, drive, motion, frame)
    return counts


def _clouds(file: store.DriveReader, rows: range) -> Iterator[cloud.Cloud]:
    for start, stop in pairwise(file["ptr"][rows.start : rows.stop + 1]):
        yield file.rows("xyz", start, stop), file.rows("cls", start, stop)


def _frames(
    drive: str, frame: np.ndarray, wholes: Iterator[cloud.Cloud], settings: Variant, points: int
) -> Iterator[graph_file.Points]:
    for number, whole in zip(frame, wholes, strict=True):
        rng = cloud.frame_rng(settings.seed, drive, int(number))
        chosen = cloud.chosen_points(whole, settings.crop_m, points, rng)
        yield *(cloud.ordered(chosen) if settings.accumulate else chosen), rng


def _images(
    drive: str, rows: range, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], settings: Variant
) -> Summary:
    with store.DriveReader(source / f"{drive}.h5", stage="ingest") as raw:
        with_image = np.flatnonzero(raw["has_image"])[rows]
        height, width = raw.shape("image")[1:3]
        images = progress.counted(raw.row("image", int(row)) for row in with_image)
        frame = raw.frame[with_image]
        counts = graph_file.write_images(file, frame, raw.time_s[with_image], images, (height, width))
        _put_motion(file, drive, motion, frame)
    return counts


def _put_motion(file: store.DriveWriter, drive: str, motion: Mapping[str, Path], frame: np.ndarray) -> None:
    for kind, folder in motion.items():
        with store.DriveReader(folder / f"{drive}.h5", stage="motion") as measured:
            graph_file.put_motion(file, kind, frame, measured)


if __name__ == "__main__":
    console.run(main)
