"""Write and convert small videos."""

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from footage import convert as conversion
from footage.convert import Converted
from footage.settings import Options
from pipeline.camera.images import read_image
from pipeline.ingest.datasets.kitti import KittiDrive
from pipeline.ingest.packets import read_times
from tests.kitti_drive import SIZE, pictures, write_video


def convert(
    folder: Path, recording: Path | list[Path], shares: Sequence[float] = (100.0,), **options: Any
) -> Converted:
    """Convert a recording of a lens of 80 degrees to drives "monday" in a folder."""
    given = Options(**{"fov": 80.0, "png": True, **options})
    paths = recording if isinstance(recording, list) else [recording]
    opened = conversion.open_recording(paths, given)
    return conversion.convert(folder, "monday", opened, given, shares=shares)


def read(folder: Path, number: int = 1) -> KittiDrive:
    """Return a drive that was written by :func:`convert`."""
    return KittiDrive(folder / f"monday_drive_{number:04d}_sync")


def times_of(drive: KittiDrive) -> list[float]:
    """Return the times of the images of a drive since its first."""
    return read_times(drive.image_times(2), [*drive.find_images(2)]).tolist()


def images_of(drive: KittiDrive) -> np.ndarray:
    """Return the images of a drive, uint8 [F,H,W,3]."""
    return np.stack([read_image(path) for path in drive.find_images(2).values()])


def write_stream(
    path: Path, frames: int = 30, codec: str = "libx264", shape: int = 1, **options: str
) -> Path:
    """Write a video with PyAV; `shape`: width / height of a pixel."""
    stream = {"codec": codec, "shape": shape, "images": pictures(frames)}
    return write_streams(path, stream, **options)


def write_streams(
    path: Path,
    *streams: dict[str, Any],
    **options: str,
) -> Path:
    """Write video streams, each a dict of the images and how they are stored."""
    with av.open(str(path), "w", options=options) as file:
        # Streams have to be complete before the first image is written.
        written = []
        for content in streams:
            codec = content.get("codec", "libx264")
            fps = content.get("fps", 10)
            stream = file.add_stream(codec, rate=fps, options=content.get("options", {}))
            stream.height, stream.width = content["images"][0].shape[:2]
            stream.pix_fmt = content.get("pixels", "yuv420p")
            stream.sample_aspect_ratio = Fraction(content.get("shape", 1))
            stream.disposition = content.get("disposition", 1)
            written.append(stream)

        for stream, content in zip(written, streams, strict=True):
            stamps = content.get("pts", range(len(content["images"])))
            for stamp, image in zip(stamps, content["images"], strict=True):
                frame = av.VideoFrame.from_ndarray(image, format="rgb24")
                frame.pts = stamp
                frame.time_base = Fraction(1, content.get("fps", 10))
                file.mux(stream.encode(frame))
            file.mux(stream.encode())
    return path


def replace_in(path: Path, old: bytes, new: bytes) -> None:
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def matrix(a: float, b: float, c: float, d: float) -> bytes:
    """Return a display matrix as MP4 stores it."""
    numbers = [round(value * 65536) for value in (a, b, 0, c, d, 0, 0, 0)]
    return struct.pack(">9i", *numbers, 1 << 30)


def show(path: Path, *turn: float) -> None:
    """Write a video of upright images, which are shown as a display matrix turns them."""
    replace_in(write_video(path, pictures(2, SIZE[::-1])), matrix(1, 0, 0, 1), matrix(*turn))
