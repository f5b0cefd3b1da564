"""Stage perception: predict depth and classes of every image with the unified encoder, data/perception/<drive>.h5."""

from collections.abc import Callable
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base import console, store
from pipeline.base.executors import default_workers
from pipeline.base.params import load
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.camera.images import to_units
from pipeline.camera.mount import camera_height
from pipeline.perception import batches, depth_scale, precomputed
from pipeline.perception.batches import Batch
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.sections.perception import Perception

if TYPE_CHECKING:
    from models.encoder.unified_encoder import UnifiedEncoder

Predict = Callable[[Batch], tuple[np.ndarray, np.ndarray]]
"""Batch → depth [B,H,W] in the network's unit, trainIds [B,H,W]."""


def main(
    ingest: Path = Path("data/ingest"),
    encoder: Path = Path("data/encoder"),
    out: Path = Path("data/perception"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Predict depth and classes of each image, scale the depth, and store both. Returns the output folder."""
    import torch

    settings = load(Perception, params)
    splits = store.read_index(ingest, stage="ingest")
    _predictor(encoder, "", settings.precision)  # report a bad checkpoint once, not from each worker
    weights = encoder / ("config.json" if precomputed.named_in(encoder) else "encoder.pt")
    jobs = [
        Job(
            drive,
            out / f"{drive}.h5",
            [ingest / f"{drive}.h5", weights],
            partial(_perceive, drive=drive, ingest=ingest, encoder=encoder, settings=settings),
        )
        for drive in splits
    ]
    if torch.cuda.is_available():  # two processes keep a GPU busy: one reads and writes while the other encodes
        workers = min(2, workers or default_workers())
    with run_over_drives("perception", settings, jobs, out, "{frames} frames".format_map, workers=workers) as summaries:
        store.write_index(out, splits)
    without = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if without:
        print(f"no images in {', '.join(without)}, so no depth and classes", flush=True)
    return out


def _perceive(path: Path, *, drive: str, ingest: Path, encoder: Path, settings: Perception) -> Summary:
    from pipeline.perception.perceive import passes

    predict, mode = _predictor(encoder, drive, settings.precision), settings.depth_scale
    params = {"perception": settings.model_dump()}
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(path, stage="perception", drive=drive, params=params) as file,
    ):
        calibrated = "T_cam_velo" in source
        camera_height_m = settings.camera_height_m or camera_height(source["T_cam_velo"] if calibrated else None)
        file.attrs["camera_height_m"] = camera_height_m
        with_image, size = np.flatnonzero(source["has_image"]), source.shape("image")[1:3]
        file.put("frame", source.frame[with_image])
        file.put("time_s", source.time_s[with_image], "s")
        file.append("depth_m", np.zeros((0, *size), np.uint16), f"{depth_scale.stored_unit(mode)}, 0 = none")
        file.append("cls", np.zeros((0, *size), np.uint8), "Cityscapes trainId")
        postprocess: DepthPostprocessor | None = None
        images = batches.read(source, with_image, settings.batch, scans=depth_scale.needs_scan(mode))
        # One thread reads, others run the network, this one scales and writes.
        with closing(passes(lambda batch: (batch, *predict(batch)), images)) as results:
            for batch, depth, cls in results:
                postprocess = postprocess or DepthPostprocessor(settings, batch.K, camera_height_m)
                frames = zip(depth, cls, batch.scans_m, strict=True)
                file.append("depth_m", to_units(np.stack([postprocess(*frame) for frame in frames])))
                file.append("cls", cls)
    return {"frames": len(with_image)}


def _predictor(encoder: Path, drive: str, precision: str) -> Predict:
    if folder := precomputed.named_in(encoder):
        return lambda batch: precomputed.read_all(folder, drive, batch.frame, batch.images.shape[1:3])

    from pipeline.perception.perceive import perceive

    network = _network(encoder)
    return lambda batch: perceive(network, batch.images, batch.K, precision)


@cache  # one for all drives of a process
def _network(encoder: Path) -> "UnifiedEncoder":
    from pipeline.perception.perceive import load

    return load(encoder)


if __name__ == "__main__":
    console.run(main)
