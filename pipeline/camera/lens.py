"""Intrinsics of a camera from a field of view or four numbers; undistortion; how far a lens
sees.
"""

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera
from pipeline.camera.images import Size

_FOCAL_PER_WIDTH = 100.0  # largest plausible ratio
# Largest offsets of a principal point from the middle, as shares of width and height: of either,
# and of both to the same side, as in an image of another size. Udacity's camera has −0.08 and 0.13.
_OFF_CENTRE, _OFF_BOTH = 0.2, 0.1
# of depth that is used, for a lens with a focal length of up to WIDE image widths
MAX_DEPTH_M, WIDE = 80.0, 0.65
MAX_TANGENTIAL = 0.01  # of p1 and p2: elements of a lens that are not parallel
MAX_FOV_DEG = 100  # of a lens without distortion
RECTIFIED_FOV_DEG = 90  # of a fisheye lens at most: beyond, the middle of the image becomes coarse


def pinhole(size: Size, fov_deg: float | None = None, K: str | None = None) -> Camera:
    """Return the camera of images of `size` (H, W), by either the horizontal angle between their
    edges or `K`.

    `fov_deg` is for square pixels and a centred principal point, `K` is "fx,fy,cx,cy" for this
    size. Raises InputError if none or both are given, or a value is implausible.
    """
    if (fov_deg is None) == (K is None):
        fix = "Pass --fov DEGREES (horizontal) or --K fx,fy,cx,cy (pixels)"
        raise InputError("expected one source of camera intrinsics", fix=fix)
    camera = _camera(size, fov_deg and math.tan(math.radians(fov_deg) / 2), K)
    covered_deg = 2 * math.degrees(math.atan(size[1] / 2 / camera.K[0, 0]))
    if covered_deg > MAX_FOV_DEG:
        problem = f"images cover {covered_deg:.0f}°, more than {MAX_FOV_DEG}°: a fisheye lens?"
        fix = "Pass its --fisheye k1,k2,k3,k4 of OpenCV's model, or 0,0,0,0 where they are unknown"
        raise InputError(problem, "--K" if K else "--fov", fix)
    return camera


def _camera(size: Size, edge: float | None, K: str | None) -> Camera:
    """Return a camera of images of `size` by `K`, or where `edge`, the half width in focal lengths,
    is given.
    """
    height, width = size
    if edge is not None:
        fx = fy = width / 2 / edge
        # Integer coordinates are pixel centres, so the image's middle is half a pixel before W / 2.
        cx, cy = (width - 1) / 2, (height - 1) / 2
    else:
        fx, fy, cx, cy = numbers(str(K), (4,), "--K 721.5,721.5,609.6,172.9")
    camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), size)
    with error_context(fix="For images that were resized, scale all four numbers"):
        check_pinhole(camera.K, size, "--K")
    return camera


def fisheye(
    size: Size, text: str, fov_deg: float | None = None, K: str | None = None
) -> tuple[Camera, Callable[[np.ndarray], np.ndarray]]:
    """Return a pinhole camera of up to 90°, and a function that rectifies a fisheye lens' images
    uint8 [H,W,3] for it.

    `text`: "k1,k2,k3,k4" of OpenCV's fisheye model, an angle θ from the axis lies θ (1 + k1 θ² + k2
    θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from the principal point; zeros: equidistant. `fov_deg` or `K`
    as in :func:`pinhole`, of the lens.
    """
    if (fov_deg is None) == (K is None):
        raise InputError(
            "expected one source of camera intrinsics", fix="Pass --fov or --K of the fisheye lens"
        )
    coefficients = np.array(numbers(text, (4,), "--fisheye 0,0,0,0"))
    radius = None  # focal lengths
    if fov_deg:
        theta = math.radians(fov_deg) / 2
        radius = theta * (1 + float(coefficients @ theta ** np.array([2, 4, 6, 8])))
    lens = _camera(size, radius, K)
    middle = lens.K[1, 2]
    edges = np.array([[[-0.5, middle], [size[1] - 0.5, middle]]])
    # tangents
    edge = np.abs(cv2.fisheye.undistortPoints(edges, lens.K, coefficients)[0, :, 0]).min()
    camera = _camera(size, min(math.tan(math.radians(RECTIFIED_FOV_DEG) / 2), float(edge)), None)
    maps = cv2.fisheye.initUndistortRectifyMap(
        lens.K, coefficients, np.eye(3), camera.K, size[::-1], cv2.CV_16SC2
    )
    return camera, lambda image: np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))


def numbers(text: str, counts: Sequence[int], example: str) -> list[float]:
    """Return the numbers of an option, as many as one of `counts`. Raises InputError."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts:
        expected = " or ".join(map(str, counts))
        raise InputError(
            f"expected {expected} numbers, got {text!r}", example.split()[0], f"Example: {example}"
        )
    return values


def undistortion(camera: Camera, text: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that rectifies images uint8 [H,W,3] of a camera with this distortion; K
    stays as it is.

    `text`: "k1,k2,p1,p2" or "k1,k2,p1,p2,k3" of OpenCV's model. Raises InputError for other texts,
    and for numbers of a fisheye lens.
    """
    coefficients = np.array(numbers(text, (4, 5), "--distortion -0.37,0.2,0,0"))
    if np.abs(coefficients[2:4]).max() > MAX_TANGENTIAL:
        problem = (
            f"p1 and p2 are {text.split(',')[2]} and {text.split(',')[3]} (expected up to "
            f"{MAX_TANGENTIAL})"
        )
        raise InputError(f"{problem}: a fisheye lens?", "--distortion", "Pass these as --fisheye")
    size = camera.size[::-1]
    maps = cv2.initUndistortRectifyMap(camera.K, coefficients, None, camera.K, size, cv2.CV_16SC2)
    return lambda image: np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))


def check_pinhole(K: np.ndarray, size: Size, where: str) -> None:
    """Raise InputError if K [3,3] is implausible for images of `size` (H, W): focal length, centre,
    skew.
    """
    height, width = size
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    focal = min(fx, fy) > 1 and max(fx, fy) < _FOCAL_PER_WIDTH * width  # false for NaN
    pinhole = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    off = np.array([cx / width, cy / height]) - 0.5
    centred = (
        np.abs(off).max() <= _OFF_CENTRE
        and not (off > _OFF_BOTH).all()
        and not (off < -_OFF_BOTH).all()
    )
    if not (focal and centred and np.allclose(K, pinhole, atol=1e-3)):
        numbers = f"focal lengths {fx:g}, {fy:g} and centre {cx:g}, {cy:g}"
        guess = "" if centred else ". K is for another image size?"
        raise InputError(
            f"implausible intrinsics of {width} x {height} pixels: {numbers}{guess}", where
        )


def depth_limit(camera: Camera) -> float:
    """Return the largest usable depth in metres, which grows with focal lengths beyond WIDE image
    widths.
    """
    return MAX_DEPTH_M * max(1.0, camera.K[0, 0] / (WIDE * camera.size[1]))
