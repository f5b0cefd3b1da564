"""Predict depth and classes of every image of a drive: data/perception/<drive>.h5."""

from collections.abc import Callable, Generator
from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import torch

from pipeline.base.resume import file_hash
from pipeline.base.runner import Summary
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.camera import Camera, read_camera
from pipeline.camera.images import DEPTH_UNITS_PER_M, to_units
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.perception.perceive import GPU_BATCH, EncoderInput, open_encoder, passes, weights_file
from pipeline.settings.perception import Perception

cached_encoder = cache(open_encoder)
"""One encoder for all drives of a process."""


def perceive_drive(
    path: Path,
    ingest: Path,
    encoder: Path,
    settings: Perception,
    *,
    advance: Callable[[int], object] = lambda frames: None,
) -> Summary:
    """Write depth and classes of each image of a drive.

    Args:
        path: of the new file.
        ingest: the drive's file of that stage.
        encoder: folder of stage encoder.
        settings: of section perception.
        advance: called with the number of frames that are done since the last call.
    """
    predict = cached_encoder(encoder, settings.precision)
    sections = {"encoder": {"sha256": file_hash(weights_file(encoder))}, "perception": settings.model_dump()}
    with (
        DriveReader(ingest, stage="ingest") as source,
        DriveWriter(path, stage="perception", drive=source.drive, params=source.params | sections) as file,
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
                advance(len(cls))
    return {"frames": len(with_image)}


def read_batches(source: DriveReader, camera: Camera, rows: np.ndarray, size: int) -> Generator[EncoderInput]:
    """Yield the frames in `rows` of a file of stage ingest in batches of `size`."""
    for start in range(0, len(rows), size):
        batch = rows[start : start + size]
        # Row by row, since frames without an image in between must not be read.
        images = np.stack([source.row("image", row) for row in batch])
        yield EncoderInput(source.drive, source.frame[batch], images, camera)
