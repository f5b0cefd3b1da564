"""Stage perception: predict depth and classes of every image with the unified encoder, data/perception/<drive>.h5."""

from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base import console, store
from pipeline.base.executors import default_workers
from pipeline.base.params import load
from pipeline.base.runner import Job, Summary, run_over_drives
from pipeline.camera.camera import read_camera
from pipeline.camera.images import DEPTH_UNITS_PER_M, to_units
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.settings.perception import Perception

if TYPE_CHECKING:
    from pipeline.perception.perceive import Predict


def main(
    ingest: Path = Path("data/ingest"),
    encoder: Path = Path("data/encoder"),
    out: Path = Path("data/perception"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Predict depth and classes of each image, scale the depth, and store both. Returns the output folder."""
    import torch

    from pipeline.perception.perceive import weights_file

    settings = load(Perception, params)
    splits = store.read_index(ingest, stage="ingest")
    _encoder(encoder, settings.precision)  # report a bad checkpoint once, not from each worker
    jobs = [
        Job(
            drive,
            out / f"{drive}.h5",
            [ingest / f"{drive}.h5", weights_file(encoder)],
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
    import torch

    from pipeline.perception.perceive import GPU_BATCH, passes, read_batches

    predict, params = _encoder(encoder, settings.precision), {"perception": settings.model_dump()}
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(path, stage="perception", drive=drive, params=params) as file,
    ):
        camera, with_image = read_camera(source, settings.camera_height_m), np.flatnonzero(source["has_image"])
        file.attrs["camera_height_m"] = camera.height_m
        file.put("frame", source.frame[with_image])
        file.put("time_s", source.time_s[with_image], "s")
        file.append("depth_m", np.zeros((0, *camera.size), np.uint16), f"1/{DEPTH_UNITS_PER_M} m, 0 = none")
        file.append("cls", np.zeros((0, *camera.size), np.uint8), "Cityscapes trainId")
        postprocess = DepthPostprocessor(settings, camera)
        size = max(settings.batch, GPU_BATCH) if torch.cuda.is_available() else settings.batch
        batches = read_batches(source, camera, with_image, size)
        # One thread reads, others run the network, this one scales and writes.
        with closing(passes(predict, batches)) as results:
            for depth, cls in results:
                file.append("depth_m", to_units(np.stack([*map(postprocess, depth, cls)])))
                file.append("cls", cls)
    return {"frames": len(with_image)}


@cache  # one for all drives of a process
def _encoder(folder: Path, precision: str) -> "Predict":
    from pipeline.perception.perceive import open_encoder

    return open_encoder(folder, precision)


if __name__ == "__main__":
    console.run(main)
