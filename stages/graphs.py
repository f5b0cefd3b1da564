"""Stage graphs: build one variant of the networks' input, data/graphs/<variant>/<drive>.h5."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError, error_context, named_frames
from pipeline.base.params import load_entry
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.graphs import accumulate, cloud, frame_graph, graph_file
from pipeline.motion import motion_file
from pipeline.settings.graphs import Variant


def main(
    name: Annotated[str, typer.Argument(metavar="VARIANT", help="an entry of graphs: in the params file")],
    data: Annotated[Path, typer.Option(help="contains the variant's source and motion")] = Path("data"),
    out: Annotated[Path, typer.Option(help="VARIANT is written below it")] = Path("data/graphs"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Sample each cloud to the variant's number of points and compute neighbours; or copy the images.

    Returns the variant's folder.
    """
    variant = load_entry(Variant, "graphs", name, params)
    source, stage = data / variant.source, variant.source.split("/")[0]
    splits = store.read_index(source, stage=stage)
    motion = motion_file.read_index(data / "motion")
    if variant.accumulate and variant.accumulate.motion not in motion:
        raise InputError(
            f"accumulate.motion = {variant.accumulate.motion!r}, but {data / 'motion'} has only {', '.join(motion)}",
            f"{params}: graphs.{name}",
            "Add it to motion.kinds and run dvc repro, or choose another kind",
        )

    jobs = [
        Job(
            drive,
            out / name / f"{drive}.h5",
            [folder / f"{drive}.h5" for folder in (source, *motion.values())],
            partial(_write, drive=drive, source=source, motion=motion, variant=variant),
        )
        for drive in splits
    ]
    settings = {**variant.model_dump(mode="json"), "motion": list(motion)}
    with run_over_drives(f"graphs@{name}", settings, jobs, out / name, _describe, workers) as summaries:
        if variant.kind != "image":
            crop = variant.crop_m and f"Widen crop_m = {list(variant.crop_m)}: left, near, right, far in metres"
            with error_context(f"{params}: graphs.{name}", crop or f"Repeat: dvc repro --force --single-item {stage}"):
                cloud.check_not_empty(summaries, splits)
        store.write_index(out / name, splits)
    before, after = (sum(summary.get(key, 0) for summary in summaries.values()) for key in ("edges_knn", "edges_kept"))
    without = [drive for drive, summary in summaries.items() if not summary["frames"]]
    share = f", {after / before:.0%} of {before} kNN edges kept" if before else ""
    print(f"{name}: {len(splits)} drives{share}" + (f"; no frames in {', '.join(without)}" if without else ""))
    return out / name


def _describe(summary: Summary) -> str:
    return ", ".join(f"{number} {name}" for name, number in summary.items())


def _write(path: Path, *, drive: str, source: Path, motion: Mapping[str, Path], variant: Variant) -> Summary:
    write = _write_images if variant.kind == "image" else _write_points
    with store.DriveWriter(path, stage="graphs", drive=drive, params={"graphs": variant.model_dump()}) as file:
        frame, counts = write(drive, file, source / f"{drive}.h5", motion, variant)
        for kind, folder in motion.items():
            with motion_file.open_motion(folder, drive) as measured:
                graph_file.put_motion(file, kind, frame, measured)
    return counts


def _write_points(
    drive: str, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], variant: Variant
) -> tuple[np.ndarray, Summary]:
    with store.DriveReader(source, stage="clouds") as clouds:
        combined = _clouds(drive, clouds, motion, variant)
        frames = (frame_graph.build(points, variant, drive, number) for number, points in combined)
        empty = frame_graph.empty(variant)
        return clouds.frame, graph_file.write(file, clouds.frame, clouds.time_s, frames, empty)


def _clouds(
    drive: str, clouds: store.DriveReader, motion: Mapping[str, Path], variant: Variant
) -> Iterator[tuple[int, cloud.Cloud]]:
    """Yield frame numbers and clouds, combined with previous ones if the variant accumulates."""
    T_before, accumulator = {}, None
    if variant.accumulate:
        accumulator = accumulate.Accumulator(variant.accumulate.frames)
        with motion_file.open_motion(motion[variant.accumulate.motion], drive) as measured:
            T_before = accumulate.read_steps(measured, variant.source)
    for row, number in enumerate(named_frames(clouds.frame.tolist())):
        points = clouds.rows_of("xyz", row), clouds.rows_of("cls", row)
        yield number, accumulator.add(number, points, T_before.get(number)) if accumulator else points


def _write_images(
    drive: str, file: store.DriveWriter, source: Path, motion: Mapping[str, Path], variant: Variant
) -> tuple[np.ndarray, Summary]:
    with store.DriveReader(source, stage="ingest") as raw:
        with_image = np.flatnonzero(raw["has_image"])
        frame = raw.frame[with_image]
        rows = zip(with_image.tolist(), named_frames(frame), strict=True)
        images = ({"image": graph_file.Column(raw.rows("image", row, row + 1), "RGB", "ptr")} for row, _ in rows)
        empty = {"image": graph_file.Column(np.empty((0, *raw.shape("image")[1:]), np.uint8), "RGB", "ptr")}
        return frame, graph_file.write(file, frame, raw.time_s[with_image], images, empty)


if __name__ == "__main__":
    console.run(main)
