"""Read depth and classes of a frame from PNG files that another program has written."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.hashes import digest, file_hash
from pipeline.camera import classes
from pipeline.camera.camera import Camera, same_shape
from pipeline.camera.images import format_size, read_classes, read_depth, resize_nearest

# Names and formats of the expected files, for messages.
LAYOUT = (
    "Expected files: DRIVE/depth/0000000000.png (16 bit, metres x 256 along the optical axis, 0 = "
    "none) and DRIVE/cls/0000000000.png (8 bit, trainIds)"
)


def find_images(folder: Path) -> list[Path]:
    """Return the PNG files below a folder, sorted. Raises InputError if there are none."""
    files = sorted(folder.glob("*/*/*.png"))
    if not files:
        raise InputError("folder has no PNG files", folder, LAYOUT)
    return files


def hash_images(folder: Path) -> tuple[int, str]:
    """Return the number of PNG files below a folder, and a hash of names and contents.

    Raises InputError if there are none.
    """
    files = find_images(folder)
    hashes = {str(file.relative_to(folder)): file_hash(file) for file in files}
    return len(files), digest(hashes)


def describe_sizes(folder: Path, drive: str, frame: int, camera: Camera) -> str:
    """Return the sizes of a frame's files, and what :func:`read_frame` takes them for.

    Only the aspect ratio tells: a file of a complete image that was squeezed to the size of
    ingested images is taken for one of these.
    """
    depth_path, cls_path = _frame_paths(folder, drive, frame)
    texts = []
    for pixels in (read_depth(depth_path), read_classes(cls_path)):
        height, width = pixels.shape[:2]
        kind = "as ingested"
        if not same_shape((height, width), camera.size):
            kind = "complete images, cropped as by stage ingest"
        texts.append(f"{kind}: {width} × {height}")
    depth_text, cls_text = texts
    if depth_text == cls_text:
        return depth_text
    return f"depth {depth_text}, classes {cls_text}"


def _frame_paths(folder: Path, drive: str, frame: int) -> tuple[Path, Path]:
    """Return the files with a frame's depth and classes."""
    name = f"{frame:010d}.png"
    return folder / drive / "depth" / name, folder / drive / "cls" / name


def read_frame(
    folder: Path, drive: str, frame: int, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame's depth and classes.

    Depth is float32 [H,W] in metres, 0 where unknown; classes are trainIds uint8 [H,W], 255 for
    void. H and W are the size of `camera`. Raises InputError.
    """
    depth_path, cls_path = _frame_paths(folder, drive, frame)
    for path in (depth_path, cls_path):
        if not path.is_file():
            raise InputError("file is missing", path, LAYOUT)
    depth = _resize_to_camera(read_depth(depth_path), camera, depth_path).astype(np.float32)
    cls = _resize_to_camera(read_classes(cls_path), camera, cls_path)
    unknown = np.setdiff1d(cls, [*range(classes.COUNT), classes.VOID])
    if unknown.size:
        problem = f"class {unknown[0]}, expected trainIds 0 to {classes.COUNT - 1}, or 255"
        raise InputError(problem, cls_path)
    return depth, cls


def _resize_to_camera(pixels: np.ndarray, camera: Camera, path: Path) -> np.ndarray:
    """Return a map of depth or classes at the size of a camera's images.

    The camera is that of ingested images. A map with their aspect ratio is resized. A map with that
    of complete images is first cropped as stage ingest crops these. Raises InputError for another
    one.
    """
    size = pixels.shape[:2]
    crop = camera.crop
    if not same_shape(size, camera.size):
        if not crop or not same_shape(size, crop.image_size):
            expected = f"ingest.image_size, {format_size(camera.size)}"
            if crop:
                expected = f"the images, {format_size(crop.image_size)}, or {expected}"
            problem = f"has {format_size(size)} pixels, expected the aspect ratio of {expected}"
            raise InputError(problem, path, "Write depth and classes of the complete images")
        pixels = crop.cut_out(resize_nearest(pixels, crop.image_size))
    return resize_nearest(pixels, camera.size)
