"""Depth and classes from PNG files of another program, by drive and frame number."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.resume import digest, file_hash
from pipeline.camera import classes
from pipeline.camera.images import nearest, read_classes, read_depth

LAYOUT = (
    "Expected files: DRIVE/depth/0000000000.png (16 bit, metres x 256, 0 = none) and "
    "DRIVE/cls/0000000000.png (8 bit, trainIds)"
)


def find(folder: Path) -> list[Path]:
    """Return the PNG files below a folder, sorted. Raises InputError if there are none."""
    files = sorted(folder.glob("*/*/*.png"))
    if not files:
        raise InputError("folder has no PNG files", folder, LAYOUT)
    return files


def fingerprint(folder: Path) -> tuple[int, str]:
    """Return the number of PNG files below a folder, and a hash of names and contents. Raises
    InputError if none.
    """
    files = find(folder)
    return len(files), digest({str(file.relative_to(folder)): file_hash(file) for file in files})


def read(
    folder: Path, drive: str, frame: int, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame's depth float32 [H,W] in metres, 0 where unknown, and trainIds uint8 [H,W],
    255 for void.

    Files of another size are resized to `size` (H, W) by nearest neighbour. Raises InputError.
    """
    paths = [folder / drive / kind / f"{frame:010d}.png" for kind in ("depth", "cls")]
    if missing := [path for path in paths if not path.is_file()]:
        raise InputError("file is missing", missing[0], LAYOUT)
    depth = nearest(read_depth(paths[0]), size).astype(np.float32)
    cls = nearest(read_classes(paths[1]), size)
    unknown = np.setdiff1d(cls, [*range(classes.COUNT), classes.VOID])
    if unknown.size:
        raise InputError(
            f"class {unknown[0]}, expected trainIds 0 to {classes.COUNT - 1}, or 255", paths[1]
        )
    return depth, cls
