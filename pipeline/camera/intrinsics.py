"""Intrinsics of a camera from a calibration file, a field of view or four numbers."""

import math
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.calib_file import check_pinhole, projection, read_entries
from pipeline.camera.geometry import scale_K
from pipeline.camera.images import Size, format_size

WAYS = "--calib FILE (a KITTI calib_cam_to_cam.txt), --fov DEGREES (horizontal) or --K fx,fy,cx,cy (pixels)"
_CAMERAS = (2, 0, 3, 1)  # first match wins: rectified cameras share one K
_FOV_DEG = (5.0, 170.0)


def intrinsics(
    size: Size, *, calib: Path | None = None, fov_deg: float | None = None, K: str | None = None
) -> np.ndarray:
    """Return the intrinsics [3,3] in pixels for images of `size` (H, W); pass exactly one of the others.

    Args:
        calib: a file like KITTI's ``calib_cam_to_cam.txt``; a rectified camera of another size is scaled.
        fov_deg: horizontal angle between the image edges, for square pixels and a centred principal point.
        K: four numbers "fx,fy,cx,cy" for this size.

    Raises InputError if none or several are given, or a value is implausible.
    """
    given = [way for way in (calib, fov_deg, K) if way is not None]
    if len(given) != 1:
        raise InputError(f"expected one source of camera intrinsics, got {len(given)}", fix=f"Pass one of {WAYS}")
    if calib is not None:
        return _from_file(calib, size)
    return _from_angle(fov_deg, size) if fov_deg is not None else _from_numbers(str(K), size)


def _from_file(path: Path, size: Size) -> np.ndarray:
    with error_context(fix="Pass a KITTI calib_cam_to_cam.txt with P_rect and S_rect of a camera to --calib"):
        entries = read_entries(path)
        number = next((number for number in _CAMERAS if f"P_rect_{number:02d}" in entries), _CAMERAS[0])
        P, calib_size = projection(entries, number, path)
    scale = size[1] / calib_size[1]
    if abs(calib_size[0] * scale - size[0]) > max(1.0, scale):  # rounding may cost a pixel of either size
        raise InputError(
            f"calibration is for {format_size(calib_size)} pixels, the images have {format_size(size)}, another "
            "aspect ratio",
            path,
            "Pass the calibration of the cropped images, or --K",
        )
    return scale_K(P[:, :3], calib_size, size)


def _from_angle(fov_deg: float, size: Size) -> np.ndarray:
    lowest, highest = _FOV_DEG
    if not lowest <= fov_deg <= highest:
        raise InputError(f"expected {lowest:g} to {highest:g} degrees, got {fov_deg:g}", "--fov")
    height, width = size
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    # Integer coordinates are pixel centres, so the image's middle is half a pixel before W / 2.
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])


def _from_numbers(text: str, size: Size) -> np.ndarray:
    try:
        fx, fy, cx, cy = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"expected fx,fy,cx,cy, got {text!r}", "--K", "Example: --K 721.5,721.5,609.6,172.9") from None
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    with error_context(fix="For images that were resized, scale all four numbers"):
        check_pinhole(K, size, "--K")
    return K
