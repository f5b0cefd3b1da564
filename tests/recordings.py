"""Write small videos and folders of images."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from tests.kitti_drive import write_png

SIZE = (48, 64)


def pictures(count: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return uint8 [count,H,W,3]: smooth, so that video codecs change them little; each has its own grey."""
    v, u = np.mgrid[: size[0], : size[1]]
    ramp = np.stack([u * 60 // size[1], v * 60 // size[0], 0 * u], axis=-1)
    return np.stack([ramp + 40 + 150 * number // count for number in range(count)]).astype(np.uint8)


def write_video(path: Path, images: Sequence[np.ndarray] | np.ndarray, fps: float = 10.0, codec: str = "mp4v") -> Path:
    """Write RGB images as a video, by default MPEG-4."""
    height, width = images[0].shape[:2]
    file = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*codec), fps, (width, height))  # type: ignore[attr-defined]
    assert file.isOpened()
    for image in images:
        file.write(np.ascontiguousarray(image[..., ::-1]))
    file.release()
    return path


def write_folder(folder: Path, images: Sequence[np.ndarray] | np.ndarray, name: str = "{:06d}.png") -> Path:
    """Write RGB images to files called `name`."""
    for number, image in enumerate(images):
        write_png(folder / name.format(number), image)
    return folder
