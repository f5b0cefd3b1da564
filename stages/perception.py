"""Stage perception: depth and classes of every image by one forward pass of the unified encoder, and their scores."""

import json
from collections.abc import Callable, Generator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import SPLITS, load
from pipeline.base.pool import Summary, run_over_drives
from pipeline.encoder import precomputed
from pipeline.fitting import checkpoint
from pipeline.fitting.prefetch import prefetch
from pipeline.perception import depth_scale
from pipeline.perception.ground_plane import ground_plane_depth
from pipeline.perception.scores import Scores
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
    folder = _precomputed(encoder)
    weights = encoder / ("config.json" if folder else "encoder.pt")
    if not folder:
        _load_model(weights)  # a bad checkpoint is one error here, not one in each worker

    import torch

    summaries = run_over_drives(
        partial(_perceive_drive, ingest=ingest, encoder=encoder, settings=settings),
        list(splits),
        module="stages.perception",
        out=out,
        inputs=lambda drive: [ingest / f"{drive}.h5", weights],
        settings=settings.model_dump(mode="json"),
        # Processes share the cores of a CPU; a GPU is kept busy by one.
        workers=1 if torch.cuda.is_available() else workers,
        frames=lambda drive: _images(ingest / f"{drive}.h5"),
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


def _perceive_drive(drive: str, path: Path, *, ingest: Path, encoder: Path, settings: Perception) -> Summary:
    from pipeline.encoder.perceive import stored_depth

    see = _seer(encoder, drive, settings.precision)
    scale: float | None = None
    scores = Scores()
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(
            path, stage="perception", drive=drive, params={"perception": settings.model_dump(mode="json")}
        ) as target,
    ):
        rows = np.flatnonzero(source["has_image"])
        K, unit = source["K"], "1/256 m" if settings.depth_scale != "none" else "1/256 of an unknown unit"
        target.put("frame", source.frame[rows])
        target.put("time_s", source.time_s[rows], "s")
        target.append("depth_m", np.zeros((0, *source.shape("image")[1:3]), np.uint16), f"{unit}, 0 = none")
        target.append("cls", np.zeros((0, *source.shape("image")[1:3]), np.uint8), "Cityscapes trainId")
        # One thread reads, one runs the network, this one scores and writes.
        with (
            closing(prefetch(_read(source, rows, settings.batch))) as inputs,
            closing(prefetch((truths, *see(images, K, frames)) for frames, images, truths in inputs)) as batches,
        ):
            for truths, depth_m, cls in batches:
                for i, truth in enumerate(truths):
                    # Without a road (or a scan) to tell it, the scale is that of the frame before.
                    scale = _scale(depth_m[i], cls[i], K, truth, settings) or scale
                    if settings.depth_scale != "none":
                        depth_m[i] *= scale or 0.0
                    _score(scores, depth_m[i], cls[i], truth, K, settings)
                target.append("depth_m", stored_depth(depth_m, cls))
                target.append("cls", cls)
                progress.advance(len(cls))
    return {"frames": len(rows), "scores": scores.sums()}


def _read(source: store.DriveReader, rows: np.ndarray, size: int) -> Generator[tuple[np.ndarray, np.ndarray, list]]:
    """Yield frame numbers, images and truths of the frames in `rows`, `size` of them at a time."""
    from pipeline.encoder.examples import read_truth

    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Row by row: few frames may have an image, and those between are not to be read.
        images = np.concatenate([source.rows("image", row, row + 1) for row in batch])
        yield source.frame[batch], images, [read_truth(source, int(row)) for row in batch]


def _score(
    scores: Scores, depth_m: np.ndarray, cls: np.ndarray, truth: Any, K: np.ndarray, settings: Perception
) -> None:
    if truth.depth_source:
        unscaled = settings.depth_scale == "none"
        factor = (depth_scale.from_truth(depth_m, truth.depth_m) or 1.0) if unscaled else 1.0
        flat = ground_plane_depth(cls, K, settings.camera_height_m)
        scores.add_depth(f"depth_{truth.depth_source}", depth_m * factor, truth.depth_m)
        scores.add_depth(f"ground_plane_{truth.depth_source}", flat, truth.depth_m)
    if truth.has_cls:
        scores.add_classes(cls, truth.cls)


def _scale(depth: np.ndarray, cls: np.ndarray, K: np.ndarray, truth: Any, settings: Perception) -> float | None:
    if settings.depth_scale == "camera_height":
        return depth_scale.from_camera_height(depth, cls, K, settings.camera_height_m)
    if settings.depth_scale == "lidar_median":
        return depth_scale.from_truth(depth, truth.depth_m)
    return 1.0


def _images(path: Path) -> int:
    with store.DriveReader(path, stage="ingest") as source:
        return int(source["has_image"].sum())


def _seer(
    encoder: Path, drive: str, precision: str
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Images uint8 [B,H,W,3], K and frame numbers → depth [B,H,W] and trainIds [B,H,W]."""
    folder = _precomputed(encoder)
    if folder:

        def read(images: np.ndarray, K: np.ndarray, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            pairs = [precomputed.read(folder, drive, int(frame), images.shape[1:3]) for frame in frames]
            depth, cls = zip(*pairs, strict=True)
            return np.stack(depth), np.stack(cls)

        return read

    from pipeline.encoder.perceive import perceive

    model = _load_model(encoder / "encoder.pt")
    return lambda images, K, frames: perceive(model, images, K, precision)


def _precomputed(encoder: Path) -> Path | None:
    """The folder that stage encoder was told to take depth and classes from, if so."""
    config = encoder / "config.json"
    content = json.loads(config.read_text(encoding="utf-8")) if config.is_file() else {}
    return Path(content["weights"]) if content.get("backbone") == precomputed.BACKBONE else None


def _load_model(path: Path) -> Any:
    import torch

    from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
    from pipeline.base.errors import InputError
    from pipeline.encoder.weights import read_weights

    weights = read_weights(path, MEND)
    try:
        model = UnifiedEncoder(weights.backbone)
    except ValueError as error:
        mend = "" if weights.backbone in BACKBONES else f". {MEND}"  # a package that is missing says what to do itself
        raise InputError(f"{path}: {error}{mend}") from error
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
        f"depth abs rel {depth['abs_rel']:.3f} (flat ground {report[f'ground_plane_{source}']['abs_rel']:.3f}), "
        f"RMSE {depth['rmse_m']:.2f} m, δ1 {depth['delta1']:.3f} against {source}"
        for source in ("dense", "lidar")
        if (depth := report[f"depth_{source}"])
    ]
    if report["classes"]:
        parts.append(f"mean IoU {report['classes']['mean_iou']:.3f} of {len(report['classes']['iou'])} classes")
    return ", ".join(parts) or "no truth to score against"


if __name__ == "__main__":
    console.run(main)
