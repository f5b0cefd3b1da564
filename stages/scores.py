"""Stage scores: what depth and classes are worth that stage perception wrote, against what the drives know of them."""

from collections.abc import Generator
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import SPLITS
from pipeline.base.pool import Summary, run_over_drives
from pipeline.camera.images import to_metres
from pipeline.encoder.truth import Truth, read_truth
from pipeline.perception.depth_scale import MODES
from pipeline.perception.scores import Scores, summary_line


def main(
    ingest: Path = Path("data/ingest"),
    perception: Path = Path("data/perception"),
    out: Path = Path("data/scores"),
    workers: int | None = None,
) -> Path:
    """Write metrics.json with the scores of each split, and <drive>/metrics.json with those of each drive.

    Depth's scale and the camera's height are those that perception wrote with. Returns the folder that it wrote.
    """
    splits = store.read_index(perception, stage="perception")
    summaries = run_over_drives(
        partial(_score_drive, ingest=ingest, perception=perception),
        list(splits),
        module="stages.scores",
        out=out,
        inputs=lambda drive: [folder / f"{drive}.h5" for folder in (ingest, perception)],
        settings={},
        workers=workers,
        target=lambda drive: out / drive,
        frames=lambda drive: _frames(perception / f"{drive}.h5"),
        describe=lambda summary: f"{summary['frames']} frames, {summary['line']}",
    )
    scores = {split: Scores() for split in SPLITS}
    for drive, summary in summaries.items():
        scores[splits[drive]].add_sums(summary["sums"])
    reports = {split: score.report() for split, score in scores.items()}
    store.write_json(out / "metrics.json", reports)
    for split, report in reports.items():
        print(f"scores, {split}: {summary_line(report)}", flush=True)
    return out


def _score_drive(drive: str, path: Path, *, ingest: Path, perception: Path) -> Summary:
    scores = Scores()
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveReader(perception / f"{drive}.h5", stage="perception") as perceived,
    ):
        count, settings = len(perceived.frame), perceived.params["perception"]
        K = source["K"] if count else np.eye(3)  # a drive without images has no camera
        for depth, cls, truth in _read(source, perceived):
            scores.add_frame(depth, cls, K, truth, MODES[settings["depth_scale"]], settings["camera_height_m"])
            progress.advance(1)
    report = scores.report()
    store.write_json(path / "metrics.json", report)
    return {"frames": count, "sums": scores.sums(), "line": summary_line(report)}


def _read(source: store.DriveReader, perceived: store.DriveReader) -> Generator[tuple[np.ndarray, np.ndarray, Truth]]:
    """Yield depth [H,W] in the unit that is stored, trainIds [H,W] and the truth of each frame that has an image."""
    for row, number in enumerate(perceived.frame):
        depth, cls = to_metres(perceived.row("depth_m", row)), perceived.row("cls", row)
        yield depth, cls, read_truth(source, source.row_of(number))


def _frames(path: Path) -> int:
    with store.DriveReader(path, stage="perception") as perceived:
        return len(perceived.frame)


if __name__ == "__main__":
    console.run(main)
