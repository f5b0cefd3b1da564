"""Stage perception: depth and classes of every image, by one forward pass of the unified encoder."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base import console, progress, store
from pipeline.base.console import default_workers
from pipeline.base.params import load
from pipeline.base.pool import Summary, run_over_frames
from pipeline.camera.mount import camera_height
from pipeline.encoder import precomputed
from pipeline.perception import batches
from pipeline.perception.batches import Batch
from pipeline.perception.depth_scale import MODES, Frame
from pipeline.perception.ground_plane import put_on_ground
from pipeline.sections.perception import Perception

if TYPE_CHECKING:
    from models.encoder.unified_encoder import UnifiedEncoder

See = Callable[[Batch], tuple[np.ndarray, np.ndarray]]


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
    _Perceive(ingest, encoder, settings).eye("")  # a bad checkpoint is one error here, not one in each worker
    weights = encoder / ("config.json" if precomputed.named_in(encoder) else "encoder.pt")
    summaries = run_over_frames(
        _Perceive(ingest, encoder, settings),
        list(splits),
        stage="perception",
        params={"perception": settings.model_dump()},
        frames=lambda drive: _images(ingest / f"{drive}.h5"),
        together=settings.batch,  # an image's last bits depend on those beside it
        out=out,
        inputs=lambda drive: [ingest / f"{drive}.h5", weights],
        settings=settings.model_dump(mode="json"),
        # A GPU is kept busy by two processes: while one encodes what it has seen, the other looks.
        workers=min(2, workers or default_workers()) if torch.cuda.is_available() else workers,
        describe=lambda summary: f"{summary['frames']} frames",
    )
    store.write_index(out, splits)
    blind = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if blind:
        print(f"without images, so without depth and classes: {', '.join(blind)}", flush=True)
    return out


@dataclass(frozen=True)
class _Perceive:
    """Writes depth and classes of a drive's images; it keeps the network from one block to the next."""

    ingest: Path
    encoder: Path
    settings: Perception

    def __call__(self, drive: str, rows: range, file: store.DriveWriter) -> Summary:
        from pipeline.encoder.perceive import passes, stored_depth

        see, mode = self.eye(drive), MODES[self.settings.depth_scale]
        factor: float | None = None
        with store.DriveReader(self.ingest / f"{drive}.h5", stage="ingest") as source:
            camera_height_m = self.settings.camera_height_m or camera_height(batches.calibration(source))
            file.attrs["camera_height_m"] = camera_height_m
            with_image, size = np.flatnonzero(source["has_image"]), source.shape("image")[1:3]
            chosen = with_image[rows.start : rows.stop]
            file.put("frame", source.frame[chosen])
            file.put("time_s", source.time_s[chosen], "s")
            file.append("depth_m", np.zeros((0, *size), np.uint16), f"{mode.unit}, 0 = none")
            file.append("cls", np.zeros((0, *size), np.uint8), "Cityscapes trainId")
            images = batches.read(source, chosen, self.settings.batch, scans=mode.needs_scan)
            # One thread reads, others run the network, this one scales and writes.
            with closing(passes(lambda batch: (batch, *see(batch)), images)) as results:
                progress.begin()
                for batch, depth, cls in results:
                    frames = _frames(batch, depth, cls, camera_height_m)
                    for frame in frames:
                        if factor is None:  # the first of the block
                            earlier = with_image[: rows.start]
                            factor = mode.factor(frame) or self._factor_of_last(source, earlier, see, camera_height_m)
                        factor = mode.rescale(frame, factor)
                        if self.settings.reach:
                            put_on_ground(frame.depth, frame.cls, batch.K, camera_height_m, self.settings.reach)
                    file.append("depth_m", stored_depth(depth, cls))
                    file.append("cls", cls)
                    progress.advance(len(cls))
        return {"frames": len(chosen)}

    def eye(self, drive: str) -> See:
        """Return what gives a batch's depth [B,H,W] and trainIds [B,H,W]."""
        if folder := precomputed.named_in(self.encoder):
            return lambda batch: precomputed.read_all(folder, drive, batch.frames, batch.images.shape[1:3])

        from pipeline.encoder.perceive import perceive

        network = self._network
        return lambda batch: perceive(network, batch.images, batch.K, self.settings.precision)

    def _factor_of_last(self, source: store.DriveReader, rows: np.ndarray, see: See, camera_height_m: float) -> float:
        """Return the factor of the last image in `rows`, those before a block, that tells one; 0.0 if none does.

        That block may not be made yet, so the network looks at them again, in the same batches.
        """
        mode, size = MODES[self.settings.depth_scale], self.settings.batch
        for stop in range(len(rows), 0, -size):
            chosen = rows[stop - size : stop]
            if mode.needs_scan and not source["has_lidar"][chosen].any():
                continue
            for batch in batches.read(source, chosen, size, scans=mode.needs_scan):
                for frame in reversed(_frames(batch, *see(batch), camera_height_m)):
                    if factor := mode.factor(frame):
                        return factor
        return 0.0

    @cached_property
    def _network(self) -> "UnifiedEncoder":
        from pipeline.encoder.perceive import load

        return load(self.encoder)


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
