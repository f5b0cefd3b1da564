"""Intrinsics of a camera from a field of view or four numbers; undistortion; the horizon's row."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import islice, pairwise

import cv2
import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import Size
from pipeline.kitti.raw import check_pinhole
from pipeline.motion.visual import best_corners, corner_quality, track

WIDTH = 640  # px, of the images that are tracked
CELL, MIN_QUALITY = 24, 2e-5
MIN_TRACKS, MIN_INLIERS = 60, 0.4
MIN_FLOW_PX = 1.0  # below, the direction of travel is noise
RANSAC_PX = 0.7
PAIRS, PAIR_EVERY, MIN_PAIRS = 60, 10, 8
MAX_TANGENTIAL = 0.01  # of p1 and p2: elements of a lens that are not parallel
MAX_FOV_DEG = 100  # of a lens without distortion
RECTIFIED_FOV_DEG = 90  # of a fisheye lens at most: beyond, the middle of the image becomes coarse


def pinhole(size: Size, fov_deg: float | None = None, K: str | None = None) -> Camera:
    """Return the camera of images of `size` (H, W), by either the horizontal angle between their edges or `K`.

    `fov_deg` is for square pixels and a centred principal point, `K` is "fx,fy,cx,cy" for this size. Raises InputError
    if none or both are given, or a value is implausible.
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
    """Return a camera of images of `size` by `K`, or where `edge`, the half width in focal lengths, is given."""
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
    """Return a pinhole camera of up to 90°, and a function that rectifies a fisheye lens' images uint8 [H,W,3] for it.

    `text`: "k1,k2,k3,k4" of OpenCV's fisheye model, an angle θ from the axis lies θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)
    focal lengths from the principal point; zeros: equidistant. `fov_deg` or `K` as in :func:`pinhole`, of the lens.
    """
    if (fov_deg is None) == (K is None):
        raise InputError("expected one source of camera intrinsics", fix="Pass --fov or --K of the fisheye lens")
    coefficients = np.array(numbers(text, (4,), "--fisheye 0,0,0,0"))
    radius = None  # focal lengths
    if fov_deg:
        theta = math.radians(fov_deg) / 2
        radius = theta * (1 + float(coefficients @ theta ** np.array([2, 4, 6, 8])))
    lens = _camera(size, radius, K)
    middle = lens.K[1, 2]
    edges = np.array([[[-0.5, middle], [size[1] - 0.5, middle]]])
    edge = np.abs(cv2.fisheye.undistortPoints(edges, lens.K, coefficients)[0, :, 0]).min()  # tangents
    camera = _camera(size, min(math.tan(math.radians(RECTIFIED_FOV_DEG) / 2), float(edge)), None)
    maps = cv2.fisheye.initUndistortRectifyMap(lens.K, coefficients, np.eye(3), camera.K, size[::-1], cv2.CV_16SC2)
    return camera, lambda image: np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))


def numbers(text: str, counts: Sequence[int], example: str) -> list[float]:
    """Return the numbers of an option, as many as one of `counts`. Raises InputError."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts:
        expected = " or ".join(map(str, counts))
        raise InputError(f"expected {expected} numbers, got {text!r}", example.split()[0], f"Example: {example}")
    return values


def undistortion(camera: Camera, text: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that rectifies images uint8 [H,W,3] of a camera with this distortion; K stays as it is.

    `text`: "k1,k2,p1,p2" or "k1,k2,p1,p2,k3" of OpenCV's model. Raises InputError for other texts, and for numbers of a
    fisheye lens.
    """
    coefficients = np.array(numbers(text, (4, 5), "--distortion -0.37,0.2,0,0"))
    if np.abs(coefficients[2:4]).max() > MAX_TANGENTIAL:
        problem = f"p1 and p2 are {text.split(',')[2]} and {text.split(',')[3]} (expected up to {MAX_TANGENTIAL})"
        raise InputError(f"{problem}: a fisheye lens?", "--distortion", "Pass these as --fisheye")
    size = camera.size[::-1]
    maps = cv2.initUndistortRectifyMap(camera.K, coefficients, None, camera.K, size, cv2.CV_16SC2)
    return lambda image: np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))


def find_horizon(frames: Iterable[Frame], camera: Camera) -> float | None:
    """Return the image row of the direction of travel; None if too few images show one.

    It is the median over pairs of consecutive images, spread over the first 600. The row depends little on the focal
    length. A camera on a car travels along the road, so this is the road's horizon.
    """
    images = (frame.image for frame in frames if frame.image is not None)
    pairs = islice(pairwise(images), 0, PAIRS * PAIR_EVERY, PAIR_EVERY)
    rows = [row for before, now in pairs if (row := _row(before, now, camera)) is not None]
    return float(np.median(rows)) if len(rows) >= MIN_PAIRS else None


def _row(before: np.ndarray, now: np.ndarray, camera: Camera) -> float | None:
    small = round(camera.size[0] * WIDTH / camera.size[1]), WIDTH
    first, second = (
        cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), small[::-1], interpolation=cv2.INTER_AREA)
        for image in (before, now)
    )
    K = camera.scaled(small).K
    uv = best_corners(corner_quality(np.asarray(first)), CELL, MIN_QUALITY)
    uv_now, tracked = track(np.asarray(first), np.asarray(second), uv, uv)
    uv, uv_now = uv[tracked].astype(np.float64), uv_now[tracked].astype(np.float64)
    if len(uv) < MIN_TRACKS or np.median(np.abs(uv_now - uv).max(axis=1)) < MIN_FLOW_PX:
        return None
    essential, inliers = cv2.findEssentialMat(uv, uv_now, K, cv2.RANSAC, 0.999, RANSAC_PX)
    if essential is None or essential.shape != (3, 3) or inliers.mean() < MIN_INLIERS:
        return None
    _, rotation, translation, _ = cv2.recoverPose(essential, uv, uv_now, K, mask=inliers)
    _, down, ahead = -rotation.T @ translation[:, 0]
    if abs(ahead) < 0.9:  # of a unit vector: not a car's motion
        return None
    row = K[1, 2] + K[1, 1] * down / ahead
    return float((row + 0.5) * camera.size[0] / small[0] - 0.5)
