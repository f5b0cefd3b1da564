"""Cut the imported drive of Udacity's Challenge 2 by time into drives for training, validation and testing.

python -m benchmarks.udacity_drives data/raw/2016_11_17/2016_11_17_drive_0001_sync

The new drives lie beside it as 0002 (0 to 100 s), 0003 (100 to 120 s) and 0004 (120 to 180 s). Frames keep their
numbers. 0004 starts 1.5 s earlier, without labels, so that windows of up to 16 frames predict all its labelled frames.
"""

import os
import shutil
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.kitti.raw import STEERING_FILE
from pipeline.labels import steering_file


class Part(NamedTuple):
    """Frame numbers of a new drive: [first, stop), with labels from `labelled` on."""

    first: int
    labelled: int
    stop: int


PARTS = {"0002": Part(0, 0, 1000), "0003": Part(1000, 1000, 1200), "0004": Part(1185, 1200, 1800)}


def main(drive: Annotated[Path, typer.Argument(help="the drive that steer import wrote, with --wheel")]) -> list[Path]:
    """Write the three drives, with hard links to the images, over earlier ones. Return their folders."""
    if "_drive_0001_" not in drive.name or not (drive / STEERING_FILE).is_file():
        raise InputError("expected a drive 0001 with steering.csv", drive, "Import it: steer import, option --wheel")
    angles, images = steering_file.read(drive / STEERING_FILE), sorted((drive / "image_02/data").iterdir())
    folders = []
    for number, part in PARTS.items():
        folder = drive.with_name(drive.name.replace("0001", number))
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "image_02/data").mkdir(parents=True)
        shutil.copy(drive / "image_02/timestamps.txt", folder / "image_02")
        for image in images:
            if part.first <= int(image.stem) < part.stop:
                os.link(image, folder / "image_02/data" / image.name)
        labelled = {frame: angle for frame, angle in angles.items() if part.labelled <= frame < part.stop}
        steering_file.write(folder / STEERING_FILE, labelled)
        folders.append(folder)
    return folders


if __name__ == "__main__":
    console.run(main)
