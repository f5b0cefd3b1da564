"""Stage perception: depth and classes of every image, by one forward pass of the unified encoder."""

from collections.abc import Callable
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.executors import default_workers
from pipeline.base.params import load
from pipeline.base.resume import stage_key
from pipeline.base.runner import Summary, run_over_drives
from pipeline.camera.mount import camera_height
from pipeline.encoder import precomputed
from pipeline.perception import batches
from pipeline.perception.batches import Batch
from pipeline.perception.depth_scale import MODES, Frame
from pipeline.perception.ground_plane import put_on_ground
from pipeline.sections.perception import Perception

if TYPE_CHECKING:
    from models.encoder.unified_encoder import UnifiedEncoder

Forward = Callable[[Batch], tuple[np.ndarray, np.ndarray]]


def main(
    ingest: Path = Path("data/ingest"),
    encoder: Path = Path("data/encoder"),
    out: Path = Path("data/perception"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Write <drive>.h5 with depth and classes of each image. Returns the folder that it wrote."""
    import torch

    settings = load(Perception, params)
    splits = store.read_index(ingest, stage="ingest")
    _forward(encoder, "", settings.precision)  # a bad checkpoint is one error here, not one in each worker
    weights = encoder / ("config.json" if precomputed.named_in(encoder) else "encoder.pt")
    dump = settings.model_dump(mode="json")
    summaries = run_over_drives(
        partial(_perceive, ingest=ingest, encoder=encoder, settings=settings),
        list(splits),
        out=out,
        key=lambda drive: stage_key("perception", {"drive": drive, **dump}, [ingest / f"{drive}.h5", weights]),
        frames=lambda drive: len(_images(ingest / f"{drive}.h5")),
        # A GPU is kept busy by two processes: one reads and writes while the other encodes.
        workers=min(2, workers or default_workers()) if torch.cuda.is_available() else workers,
        describe=lambda summary: f"{summary['frames']} frames",
    )
    store.write_index(out, splits)
    blind = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if blind:
        print(f"without images, so without depth and classes: {', '.join(blind)}", flush=True)
    return out


def _perceive(drive: str, path: Path, *, ingest: Path, encoder: Path, settings: Perception) -> Summary:
    """Write depth and classes of a drive's images."""
    from pipeline.encoder.perceive import passes, stored_depth

    forward, mode = _forward(encoder, drive, settings.precision), MODES[settings.depth_scale]
    params = {"perception": settings.model_dump()}
    factor: float | None = None
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(path, stage="perception", drive=drive, params=params) as file,
    ):
        camera_height_m = settings.camera_height_m or camera_height(batches.calibration(source))
        file.attrs["camera_height_m"] = camera_height_m
        with_image, size = np.flatnonzero(source["has_image"]), source.shape("image")[1:3]
        file.put("frame", source.frame[with_image])
        file.put("time_s", source.time_s[with_image], "s")
        file.append("depth_m", np.zeros((0, *size), np.uint16), f"{mode.unit}, 0 = none")
        file.append("cls", np.zeros((0, *size), np.uint8), "Cityscapes trainId")
        images = batches.read(source, with_image, settings.batch, scans=mode.needs_scan)
        # One thread reads, others run the network, this one scales and writes.
        with closing(passes(lambda batch: (batch, *forward(batch)), images)) as results:
            for batch, depth, cls in results:
                for frame in _frames(batch, depth, cls, camera_height_m):
                    factor = mode.rescale(frame, mode.factor(frame) or 0.0 if factor is None else factor)
                    if settings.reach:
                        put_on_ground(frame.depth, frame.cls, batch.K, camera_height_m, settings.reach)
                file.append("depth_m", stored_depth(depth, cls))
                file.append("cls", cls)
                progress.advance(len(cls))
    return {"frames": len(with_image)}


def _forward(encoder: Path, drive: str, precision: str) -> Forward:
    """Return the function from a batch to depth [B,H,W] and trainIds [B,H,W]."""
    if folder := precomputed.named_in(encoder):
        return lambda batch: precomputed.read_all(folder, drive, batch.frames, batch.images.shape[1:3])

    from pipeline.encoder.perceive import perceive

    network = _network(encoder)
    return lambda batch: perceive(network, batch.images, batch.K, precision)


@cache  # one for all drives of a process
def _network(encoder: Path) -> "UnifiedEncoder":
    from pipeline.encoder.perceive import load

    return load(encoder)


def _frames(batch: Batch, depth: np.ndarray, cls: np.ndarray, camera_height_m: float) -> list[Frame]:
    return [
        Frame(metres, seen, scan_m, batch.K, camera_height_m)
        for metres, seen, scan_m in zip(depth, cls, batch.scans_m, strict=True)
    ]


def _images(path: Path) -> list[int]:
    """Return the numbers of the frames that have an image."""
    with store.DriveReader(path, stage="ingest") as source:
        return [int(number) for number in source.frame[source["has_image"] > 0]]


if __name__ == "__main__":
    console.run(main)
