"""Stage perception: depth and classes of every image, by one forward pass of the unified encoder."""

from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.params import load
from pipeline.base.pool import Summary, run_over_drives
from pipeline.camera.mount import camera_height
from pipeline.encoder import precomputed
from pipeline.perception import batches
from pipeline.perception.batches import Batch
from pipeline.perception.depth_scale import MODES, Frame
from pipeline.perception.ground_plane import put_on_ground
from pipeline.sections.perception import Perception


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
    _eye(encoder, "", settings.precision)  # a bad checkpoint is one error here, not one in each worker
    weights = encoder / ("config.json" if precomputed.named_in(encoder) else "encoder.pt")
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
        describe=lambda summary: f"{summary['frames']} frames",
    )
    store.write_index(out, splits)
    blind = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if blind:
        print(f"without images, so without depth and classes: {', '.join(blind)}", flush=True)
    return out


def _perceive_drive(drive: str, path: Path, *, ingest: Path, encoder: Path, settings: Perception) -> Summary:
    from pipeline.encoder.perceive import passes, stored_depth

    see, mode, factor = _eye(encoder, drive, settings.precision), MODES[settings.depth_scale], 0.0
    params = {"perception": settings.model_dump()}
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(path, stage="perception", drive=drive, params=params) as target,
    ):
        camera_height_m = settings.camera_height_m or camera_height(batches.calibration(source))
        target.attrs["camera_height_m"] = camera_height_m
        rows, size = np.flatnonzero(source["has_image"]), source.shape("image")[1:3]
        target.put("frame", source.frame[rows])
        target.put("time_s", source.time_s[rows], "s")
        target.append("depth_m", np.zeros((0, *size), np.uint16), f"{mode.unit}, 0 = none")
        target.append("cls", np.zeros((0, *size), np.uint8), "Cityscapes trainId")
        images = batches.read(source, rows, settings.batch, scans=mode.needs_scan)
        # One thread reads, others run the network, this one scales and writes.
        with closing(passes(lambda batch: (batch, *see(batch)), images)) as results:
            for batch, depth, cls in results:
                for metres, seen, scan_m in zip(depth, cls, batch.scans_m, strict=True):
                    factor = mode.rescale(Frame(metres, seen, scan_m, batch.K, camera_height_m), factor)
                    if settings.reach:
                        put_on_ground(metres, seen, batch.K, camera_height_m, settings.reach)
                target.append("depth_m", stored_depth(depth, cls))
                target.append("cls", cls)
                progress.advance(len(cls))
    return {"frames": len(rows)}


def _eye(encoder: Path, drive: str, precision: str) -> Callable[[Batch], tuple[np.ndarray, np.ndarray]]:
    """Return what gives a batch's depth [B,H,W] and trainIds [B,H,W]."""
    if folder := precomputed.named_in(encoder):
        return lambda batch: precomputed.read_all(folder, drive, batch.frames, batch.images.shape[1:3])

    from pipeline.encoder.perceive import load, perceive

    model = load(encoder)
    return lambda batch: perceive(model, batch.images, batch.K, precision)


def _images(path: Path) -> int:
    with store.DriveReader(path, stage="ingest") as source:
        return int(source["has_image"].sum())


if __name__ == "__main__":
    console.run(main)
