"""Stage perception: depth and classes of every image by one forward pass of the unified encoder, and their scores."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import checkpoint, console, store
from pipeline.drives import Summary, run_over_drives
from pipeline.image_metrics import Scores
from pipeline.params import SPLITS, load
from pipeline.sections.perception import Perception

MEND = "Make it again: dvc repro --force encoder"


def main(
    ingest: Path = Path("data/ingest"),
    encoder: Path = Path("data/encoder"),
    out: Path = Path("data/perception"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> None:
    """Write <drive>.h5 with depth and classes of each image, and metrics.json with the scores of each split."""
    settings = load(Perception, params)
    splits = store.read_index(ingest, stage="ingest")
    weights = encoder / "encoder.pt"
    _load_model(weights)  # a bad checkpoint is one error here, not one in each worker

    import torch

    summaries = run_over_drives(
        partial(_perceive_drive, ingest=ingest, weights=weights, settings=settings),
        list(splits),
        module="stages.perception",
        out=out,
        inputs=lambda drive: [ingest / f"{drive}.h5", weights],
        settings=settings.model_dump(mode="json"),
        # Processes share the cores of a CPU; a GPU is kept busy by one.
        workers=1 if torch.cuda.is_available() else workers,
        describe=_describe,
    )
    scores = {split: Scores() for split in SPLITS}
    for drive, summary in summaries.items():
        scores[splits[drive]].add_sums(summary["scores"])
    store.write_json(out / "metrics.json", {split: score.report() for split, score in scores.items()})
    store.write_index(out, splits)
    empty = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if empty:
        print(f"without images, so without depth and classes: {', '.join(empty)}", flush=True)
    for split, score in scores.items():
        print(f"perception, {split}: {_scored(score)}", flush=True)


def _perceive_drive(drive: str, path: Path, *, ingest: Path, weights: Path, settings: Perception) -> Summary:
    from pipeline.perceive import perceive, stored_depth
    from pipeline.supervision import read_truth

    model = _load_model(weights)
    scores = Scores()
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(
            path, stage="perception", drive=drive, params={"perception": settings.model_dump(mode="json")}
        ) as target,
    ):
        rows = np.flatnonzero(source["has_image"])
        target.put("frame", source.frame[rows])
        target.put("time_s", source.time_s[rows], "s")
        target.append("depth_m", np.zeros((0, *source.shape("image")[1:3]), np.uint16), "1/256 m, 0 = none")
        target.append("cls", np.zeros((0, *source.shape("image")[1:3]), np.uint8), "Cityscapes trainId")
        for start in range(0, len(rows), settings.batch):
            batch = rows[start : start + settings.batch]
            images = source.rows("image", batch[0], batch[-1] + 1)[batch - batch[0]]
            depth_m, cls = perceive(model, images, source["K"])
            target.append("depth_m", stored_depth(depth_m, cls))
            target.append("cls", cls)
            for row, frame_depth, frame_cls in zip(batch, depth_m, cls, strict=True):
                truth = read_truth(source, int(row))
                if truth.depth_source:
                    scores.add_depth(truth.depth_source, frame_depth, truth.depth_m)
                if truth.has_cls:
                    scores.add_classes(frame_cls, truth.cls)
    return {"frames": len(rows), "scores": scores.sums()}


def _load_model(path: Path) -> Any:
    import torch

    from models.unified_encoder import UnifiedEncoder
    from pipeline.errors import InputError
    from pipeline.weights import read_weights

    weights = read_weights(path, MEND)
    try:
        model = UnifiedEncoder(weights.backbone)
    except ValueError as error:
        raise InputError(f"{path}: {error}. {MEND}") from error
    checkpoint.load_state(model, weights.state, path, MEND)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # 1.6x faster on a CPU, measured
    return model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def _describe(summary: Summary) -> str:
    scores = Scores()
    scores.add_sums(summary["scores"])
    return f"{summary['frames']} frames, {_scored(scores)}"


def _scored(scores: Scores) -> str:
    report = scores.report()
    parts = [
        f"depth abs rel {depth['abs_rel']:.3f}, RMSE {depth['rmse_m']:.2f} m, δ1 {depth['delta1']:.3f} against {source}"
        for source in ("dense", "lidar")
        if (depth := report[f"depth_{source}"])
    ]
    if report["classes"]:
        parts.append(f"mean IoU {report['classes']['mean_iou']:.3f} of {len(report['classes']['iou'])} classes")
    return ", ".join(parts) or "no truth to score against"


if __name__ == "__main__":
    console.run(main)
