"""The intrinsics of somebody's own camera, said in one of three ways."""

import math
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.calib_file import projection, read_entries
from pipeline.camera.geometry import scale_K
from pipeline.camera.images import Size

WAYS = "--calib FILE (a KITTI calib_cam_to_cam.txt), --fov DEGREES (horizontal) or --K fx,fy,cx,cy (pixels)"
_CAMERAS = (2, 0, 3, 1)  # of a calibration with several, the first of these: they are rectified to one K
_FOV_DEG = (5.0, 170.0)


def intrinsics(
    size: Size, *, calib: Path | None = None, fov_deg: float | None = None, K: str | None = None
) -> np.ndarray:
    """Return the intrinsics [3,3] of images of `size` (H, W), in pixels, told in exactly one way.

    Args:
        calib: a file as KITTI's ``calib_cam_to_cam.txt``; its rectified camera of another size is scaled.
        fov_deg: the angle between the left and the right edge, of square pixels and a centred principal point.
        K: four numbers "fx,fy,cx,cy" for this size.

    Raises InputError if none or several are told, or one cannot be true.
    """
    told = [way for way in (calib, fov_deg, K) if way is not None]
    if len(told) != 1:
        raise InputError(
            f"the camera's intrinsics are said {'more than once' if told else 'nowhere'}: say one of {WAYS}"
        )
    if calib is not None:
        return _of_file(calib, size)
    return _of_angle(fov_deg, size) if fov_deg is not None else _of_numbers(str(K), size)


def _of_file(path: Path, size: Size) -> np.ndarray:
    with error_context(fix="--calib wants a KITTI calib_cam_to_cam.txt, with P_rect and S_rect of a camera"):
        entries = read_entries(path)
        number = next((number for number in _CAMERAS if f"P_rect_{number:02d}" in entries), _CAMERAS[0])
        P, (height, width) = projection(entries, number, path)
    scale = size[1] / width
    if abs(height * scale - size[0]) > max(1.0, scale):  # a pixel of either, which rounding may cost
        raise InputError(
            f"{path} is for images of {width} x {height} pixels, these are {size[1]} x {size[0]}: of another shape, so "
            "they were cropped or are another camera's"
        )
    return scale_K(P[:, :3], (height, width), size)


def _of_angle(fov_deg: float, size: Size) -> np.ndarray:
    lowest, highest = _FOV_DEG
    if not lowest <= fov_deg <= highest:
        raise InputError(
            f"--fov {fov_deg:g} is not between {lowest:g} and {highest:g} degrees, edge to edge of the width"
        )
    height, width = size
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    # Integer coordinates are pixel centres, so the image's middle is half a pixel before W / 2.
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])


def _of_numbers(text: str, size: Size) -> np.ndarray:
    try:
        fx, fy, cx, cy = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--K {text} is not four numbers fx,fy,cx,cy: say as --K 721.5,721.5,609.6,172.9") from None
    height, width = size
    # The comparisons are false for what is not a number.
    if not (0 < fx < math.inf and 0 < fy < math.inf and 0 <= cx < width and 0 <= cy < height):
        raise InputError(
            f"--K {text}: fx and fy are positive, and cx, cy lies in the image of {width} x {height} pixels; of "
            "images that were resized, all four are scaled"
        )
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
