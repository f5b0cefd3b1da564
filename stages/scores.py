"""Stage scores: what depth, classes and measured motion are worth, against what the drives know of them."""

from collections.abc import Generator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import SPLITS, load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.camera.images import to_metres
from pipeline.encoder.truth import Truth, read_truth, visible
from pipeline.kitti.oxts import VF, WU
from pipeline.motion import kinds
from pipeline.perception import motion_scores
from pipeline.perception.depth_scale import MODES
from pipeline.perception.scores import Scores, summary_line
from pipeline.sections.labels import Labels

Car = Mapping[str, float]
"""The labels' wheelbase_m and min_speed_mps."""


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    motion: Path = Path("data/motion"),
    out: Path = Path("data/scores"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Write metrics.json with the scores of each split, and <drive>/metrics.json with those of each drive.

    Depth's scale and the camera's height are those that perception wrote with. Under ``motion`` stand the score cards
    of each kind of measured motion, whose angles are made and judged as the labels are. Returns the folder that it
    wrote.
    """
    labels = load(Labels, params)
    car = {"wheelbase_m": labels.wheelbase_m, "min_speed_mps": labels.min_speed_mps}
    splits = store.read_index(perception, stage="perception")
    measured = kinds.read(motion)

    def key(drive: str) -> str:
        inputs = [folder / f"{drive}.h5" for folder in (ingest, perception, *measured.values())]
        return stage_key("scores", {"drive": drive, "motion": list(measured), **car}, inputs)

    summaries = run_over_drives(
        partial(_score_drive, ingest=ingest, perception=perception, motion=measured, car=car),
        list(splits),
        out=out,
        key=key,
        workers=workers,
        target=lambda drive: out / drive,
        frames=lambda drive: _frames(perception / f"{drive}.h5"),
        describe=lambda summary: f"{summary['frames']} frames, {summary['line']}",
    )
    scores = {split: Scores() for split in SPLITS}
    for drive, summary in summaries.items():
        scores[splits[drive]].add_sums(summary["sums"])
    reports = {split: score.report() for split, score in scores.items()}
    cards = {
        kind: {
            split: motion_scores.card(
                _motion_errors(drive, ingest, folder, car) for drive in store.of_split(splits, split)
            )
            for split in SPLITS
        }
        for kind, folder in measured.items()
    }
    store.write_json(out / "metrics.json", {**reports, "motion": cards})
    for split, report in reports.items():
        print(f"scores, {split}: {summary_line(report)}", flush=True)
        for kind in measured:
            print(f"{kind} motion, {split}: {motion_scores.summary_line(cards[kind][split])}", flush=True)
    return out


def _score_drive(
    drive: str, path: Path, *, ingest: Path, perception: Path, motion: Mapping[str, Path], car: Car
) -> Summary:
    scores = Scores()
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
    ):
        count, scale = len(perceived.frame), MODES[perceived.params["perception"]["depth_scale"]]
        K = source["K"] if count else np.eye(3)  # a drive without images has no camera
        for depth, cls, truth in _read(source, perceived):
            scores.add_frame(depth, cls, K, truth, scale, float(perceived.attrs["camera_height_m"]))
            progress.advance(1)
    report = scores.report()
    cards = {kind: motion_scores.card([_motion_errors(drive, ingest, folder, car)]) for kind, folder in motion.items()}
    store.write_json(path / "metrics.json", {**report, "motion": cards})
    lines = [
        summary_line(report),
        *(f"{kind} motion: {motion_scores.summary_line(one)}" for kind, one in cards.items()),
    ]
    return {"frames": count, "sums": scores.sums(), "line": "; ".join(lines)}


def _motion_errors(drive: str, ingest: Path, motion: Path, car: Car) -> motion_scores.Errors:
    """Return what a drive's measured motion gets wrong; both files go by frame number."""
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveReader(motion / f"{drive}.h5", stage="motion") as measured,
    ):
        oxts = source["oxts"][np.searchsorted(source.frame, measured.frame)]
        return motion_scores.errors(
            measured["yaw_rate_radps"], measured["speed_mps"], measured["valid"], oxts[:, WU], oxts[:, VF], **car
        )


def _read(source: store.DriveReader, perceived: store.DriveReader) -> Generator[tuple[np.ndarray, np.ndarray, Truth]]:
    """Yield depth [H,W] in the unit that is stored, trainIds [H,W] and the truth of each frame that has an image."""
    for row, number in enumerate(perceived.frame):
        depth, cls = to_metres(perceived.row("depth_m", row)), perceived.row("cls", row)
        truth = read_truth(source, source.row_of(number))
        if truth.depth_source == "lidar":
            truth = replace(truth, depth_m=visible(truth.depth_m, source["K"]))
        yield depth, cls, truth


def _frames(path: Path) -> int:
    with store.DriveReader(path, stage="perception") as perceived:
        return len(perceived.frame)


if __name__ == "__main__":
    console.run(main)
