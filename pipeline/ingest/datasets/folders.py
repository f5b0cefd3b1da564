"""Read folders of rectified images with angles: an example of a dataset of one's own.

Drive NAME is data/raw/NAME/, with the images 0000.png, 0001.png and so on, ten a second, and the
file steering.csv with the columns frame and steering_rad.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import read_image
from pipeline.ingest.drive import Drive, list_file_facts
from pipeline.ingest.packets import STEERING, read_values
from pipeline.ingest.settings import Ingest

# The camera: intrinsics in pixels, and height and width of the images.
CAMERA = Camera(np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]]), (480, 640))
# Images per second.
HZ = 10.0


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return the names, sizes and times of the drive's files."""
    return list_file_facts([*_list_images(root / name), root / name / STEERING], root)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return a drive, with steering angles."""
    images = _list_images(root / name)

    def frames() -> Iterator[Frame]:
        for path in images:
            number = int(path.stem)
            yield Frame(number, number / HZ, image=partial(read_image, path, size=CAMERA.size))

    return Drive(CAMERA, frames, read_values(root / name / STEERING))


def _list_images(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.png"))
