"""Make one graph variant, all that a network sees: data/graphs/<variant>/<drive>.h5."""

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, progress, store
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import load_entry
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
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
    dump = settings.model_dump(mode="json")

    def key(drive: str) -> str:
        inputs = [folder / f"{drive}.h5" for folder in (source, *measured.values())]
        return stage_key("graphs", {"drive": drive, **dump, "motion": list(measured)}, inputs)

    summaries = run_over_drives(
        partial(_write, source=source, motion=measured, settings=settings),
        list(splits),
        out=out / name,
        key=key,
        pending=out.parent / ".resume" / f"{out.name}-{name}",
        frames=lambda drive: _count(source / f"{drive}.h5", stage),
        workers=workers,
        describe=lambda summary: ", ".join(f"{number} {what}" for what, number in summary.items()),
    )
    if settings.kind != "image":
        crop = settings.crop_m and f"Widen crop_m = {list(settings.crop_m)}: left, near, right, far in metres"
        fix = crop or f"Make the clouds again: dvc repro --force --single-item {stage}"
        with error_context(f"{params}: graphs.{name}", fix):
            cloud.check_any(summaries, splits)
    store.write_index(out / name, splits)
    before, after = (sum(summary.get(key, 0) for summary in summaries.values()) for key in ("kNN edges", "kept"))
    if before:
        print(f"{name}: {after / before:.0%} of {before} kNN edges kept")
    empty = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if empty:
        print(f"{name}: no frames in {', '.join(empty)} (nothing to make them from)")
    return out / name


def _count(source: Path, stage: str) -> int:
    """Return the number of frames in a drive's graph file."""
    with store.DriveReader(source, stage=stage) as file:
        return int(file["has_image"].sum()) if stage == "ingest" else len(file.frame)


def _write(drive: str, path: Path, *, source: Path, motion: Mapping[str, Path], settings: Variant) -> Summary:
    write = _write_images if settings.kind == "image" else _write_points
    with store.DriveWriter(path, stage="graphs", drive=drive, params={"graphs": settings.model_dump()}) as file:
        frame, counts = write(drive, file, source / f"{drive}.h5", motion, settings)
        for kind, folder in motion.items():
            with store.DriveReader(folder / f"{drive}.h5", stage="motion") as measured:
                graph_file.put_motion(file, kind, frame, measured)
    return counts


def _write_points(
    drive: str, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], settings: Variant
) -> tuple[np.ndarray, Summary]:
    assert settings.points  # as every variant of points has
    neighbours: graph_file.Neighbours
    if settings.kind == "graph":
        assert settings.k
        neighbours = graph_file.KnnGraph(settings.points, settings.k, settings.keep_inter_class)
    else:
        neighbours = graph_file.PointSets(settings.points, settings.levels)
    with store.DriveReader(source, stage="clouds") as clouds:
        wholes = _clouds(clouds)
        if settings.accumulate:
            with store.DriveReader(motion[settings.accumulate.motion] / f"{drive}.h5", stage="motion") as measured:
                T_before = accumulate.steps(measured, settings.source)
            most = settings.accumulate.frames
            wholes = accumulate.accumulated(clouds.frame.tolist(), wholes, T_before, most)
        frames = _frames(drive, clouds.frame, wholes, settings, settings.points)
        return clouds.frame, graph_file.write_points(file, clouds.frame, clouds.time_s, frames, neighbours)


def _clouds(file: store.DriveReader) -> Iterator[cloud.Cloud]:
    for start, stop in pairwise(file["ptr"]):
        yield file.rows("xyz", start, stop), file.rows("cls", start, stop)


def _frames(
    drive: str, frame: np.ndarray, wholes: Iterator[cloud.Cloud], settings: Variant, points: int
) -> Iterator[graph_file.Points]:
    for number, whole in zip(progress.track(frame), wholes, strict=True):
        rng = cloud.frame_rng(settings.seed, drive, int(number))
        chosen = cloud.chosen_points(whole, settings.crop_m, points, rng)
        yield *(cloud.ordered(chosen) if settings.accumulate else chosen), rng


def _write_images(
    drive: str, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], settings: Variant
) -> tuple[np.ndarray, Summary]:
    with store.DriveReader(source, stage="ingest") as raw:
        with_image = np.flatnonzero(raw["has_image"])
        frame = raw.frame[with_image]
        images = (raw.row("image", int(row)) for row, _ in zip(with_image, progress.track(frame), strict=True))
        height, width = raw.shape("image")[1:3]
        return frame, graph_file.write_images(file, frame, raw.time_s[with_image], images, (height, width))


if __name__ == "__main__":
    console.run(main)
