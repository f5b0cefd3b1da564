"""Read depth and classes of a frame from PNG files that another program has written."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.resume import digest, file_hash
from pipeline.camera import classes
from pipeline.camera.images import nearest, read_classes, read_depth

# Names and formats of the expected files, for messages.
LAYOUT = (
    "Expected files: DRIVE/depth/0000000000.png (16 bit, metres x 256, 0 = none) and "
    "DRIVE/cls/0000000000.png (8 bit, trainIds)"
)


def find_images(folder: Path) -> list[Path]:
    """Return the PNG files below a folder, sorted. Raises InputError if there are none."""
    files = sorted(folder.glob("*/*/*.png"))
    if not files:
        raise InputError("folder has no PNG files", folder, LAYOUT)
    return files


def fingerprint(folder: Path) -> tuple[int, str]:
    """Return the number of PNG files below a folder, and a hash of names and contents.

    Raises InputError if there are none.
    """
    files = find_images(folder)
    hashes = {str(file.relative_to(folder)): file_hash(file) for file in files}
    return len(files), digest(hashes)


def read_frame(
    folder: Path, drive: str, frame: int, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame's depth and classes.

    Depth is float32 [H,W] in metres, 0 where unknown; classes are trainIds uint8 [H,W], 255 for
    void. Files of another size are resized to `size` (H, W) by nearest neighbour. Raises
    InputError.
    """
    depth_path = folder / drive / "depth" / f"{frame:010d}.png"
    cls_path = folder / drive / "cls" / f"{frame:010d}.png"
    for path in (depth_path, cls_path):
        if not path.is_file():
            raise InputError("file is missing", path, LAYOUT)
    depth = nearest(read_depth(depth_path), size).astype(np.float32)
    cls = nearest(read_classes(cls_path), size)
    unknown = np.setdiff1d(cls, [*range(classes.COUNT), classes.VOID])
    if unknown.size:
        problem = f"class {unknown[0]}, expected trainIds 0 to {classes.COUNT - 1}, or 255"
        raise InputError(problem, cls_path)
    return depth, cls
