"""Make the camera of a recording from its options, and rectify the images of its lens."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from footage.settings import Options
from pipeline.base.errors import InputError, error_context
from pipeline.base.summary import DOUBT
from pipeline.camera.camera import Camera
from pipeline.camera.images import Crop, Size, format_size, resize_image
from pipeline.camera.pinhole import check_pinhole

# A function that rectifies an image uint8 [H,W,3].
Rectify = Callable[[np.ndarray], np.ndarray]

# Largest width of frames in pixels, which is that of KITTI's.
MAX_WIDTH = 1242
# Largest magnitude of p1 and p2 in OpenCV's model, which describe elements of a lens that are not
# parallel. Larger values suggest that the numbers describe a fisheye lens.
MAX_TANGENTIAL = 0.01
# Largest field of view in degrees of a lens without distortion.
MAX_FOV_DEG = 100
# Largest field of view in degrees of a rectified fisheye lens. Beyond it, the middle of the image
# becomes coarse.
RECTIFIED_FOV_DEG = 90


class Lens(NamedTuple):
    """How images of a recording become frames."""

    size: Size  # of the images
    rectify: Rectify
    camera: Camera  # of the frames

    def to_frame(self, image: np.ndarray, path: Path) -> np.ndarray:
        """Return the rectified image of a file in the size of the camera. Raises InputError."""
        if image.shape[:2] != self.size:
            problem = f"an image has {format_size(image.shape)} pixels"
            expected = f"expected {format_size(self.size)}, as the first one"
            fix = "Import recordings of other sizes separately"
            raise InputError(f"{problem}, {expected}", path, fix)
        return resize_image(self.rectify(image), self.camera.size)


def open_lens(options: Options, size: Size, path: Path) -> Lens:
    """Return the lens of the images of `size` in a file, whose frames have at most MAX_WIDTH.

    The field of view is the angle between the left and right edge of the image, and gives square
    pixels and a centred principal point. Raises InputError for images of a camera on its side, and
    for options that do not fit.
    """
    camera, rectify = _open_model(options, size, path)
    height, width = size
    if width > MAX_WIDTH:
        camera = camera.scaled((round(height * MAX_WIDTH / width), MAX_WIDTH))
    return Lens(size, rectify, camera)


def _open_model(options: Options, size: Size, path: Path) -> tuple[Camera, Rectify]:
    """Return the camera of rectified images of `size`, and the function that rectifies them."""
    if size[0] > size[1]:
        raise InputError(
            f"images are taller than wide ({format_size(size)} pixels): is it rotated by 90 "
            "degrees?",
            path,
            "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)",
        )
    if (options.fov_deg is None) == (options.K is None):
        fix = "Pass --fov DEGREES (horizontal) or --K fx,fy,cx,cy (pixels)"
        raise InputError("expected one source of camera intrinsics", fix=fix)
    if options.distortion and options.fisheye:
        fix = "Pass --distortion or --fisheye"
        raise InputError("expected one model of the lens, got two", fix=fix)
    if options.fisheye:
        return _open_fisheye(options, size, options.fisheye)

    camera = _read_intrinsics(options, size)
    covered_deg = 2 * math.degrees(math.atan(size[1] / 2 / camera.K[0, 0]))
    if covered_deg > MAX_FOV_DEG:
        problem = f"images cover {covered_deg:.0f}°, more than {MAX_FOV_DEG}°: a fisheye lens?"
        fix = "Pass its --fisheye k1,k2,k3,k4 of OpenCV's model, or 0,0,0,0 where they are unknown"
        raise InputError(problem, "--K" if options.K else "--fov", fix)
    if options.distortion:
        return camera, _undistort_images(camera, options.distortion)
    return camera, lambda image: image


def _read_intrinsics(options: Options, size: Size) -> Camera:
    """Return a camera with the intrinsics of images of `size` as they are recorded."""
    if options.fov_deg is None:
        return _parse_K(size, options.K or "")
    theta = math.radians(options.fov_deg) / 2
    if not options.fisheye:
        return _centred_camera(size, math.tan(theta))
    factor = 1 + float(_parse_fisheye(options.fisheye) @ theta ** np.array([2, 4, 6, 8]))
    return _centred_camera(size, theta * factor)


def border_doubt(options: Options, crop: Crop) -> str:
    """Return a doubt about images with borders around a `crop`, and the options without them.

    A field of view is taken for that of the picture between the borders, which the lens made.
    """
    if options.K:
        K = _read_intrinsics(options, crop.image_size).cropped(crop).K
    else:
        K = _read_intrinsics(options, crop.size).K
    height, width = crop.size
    left = crop.columns.start
    top = crop.rows.start
    intrinsics = f"{K[0, 0]:.1f},{K[1, 1]:.1f},{K[0, 2]:.1f},{K[1, 2]:.1f}"
    return (
        f"{DOUBT}images have borders that never change, around a picture of "
        f"{format_size(crop.size)} pixels, as no lens makes them: crop them, ffmpeg -i in.mp4 -vf "
        f"crop={width}:{height}:{left}:{top} out.mp4, and pass --K {intrinsics}"
    )


def _centred_camera(size: Size, half_width: float) -> Camera:
    """Return a centred camera for images of `size`, half as wide as `half_width` focal lengths."""
    height, width = size
    focal = width / 2 / half_width
    # Integer coordinates are pixel centres, so the image's middle is half a pixel before W / 2.
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Camera(K, size)


def _parse_K(size: Size, text: str) -> Camera:
    """Return a camera for images of `size` from the text of the option --K. Raises InputError."""
    fx, fy, cx, cy = parse_numbers(text, (4,), "--K 721.5,721.5,609.6,172.9")
    camera = Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), size)
    with error_context(fix="For images that were resized, scale all four numbers"):
        check_pinhole(camera.K, size, "--K")
    return camera


def _open_fisheye(options: Options, size: Size, text: str) -> tuple[Camera, Rectify]:
    """Return a pinhole camera of up to 90°, and a function that rectifies images for it.

    `text` is "k1,k2,k3,k4" of OpenCV's fisheye model. In this model, a ray at an angle θ from the
    axis is seen θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) focal lengths from the principal point. With
    zeros, the lens is equidistant.
    """
    coefficients = _parse_fisheye(text)
    lens = _read_intrinsics(options, size)

    # The rectified image reaches as far to both sides as the lens sees on its narrower side, but
    # covers at most RECTIFIED_FOV_DEG.
    row = lens.K[1, 2]
    edges = np.array([[[-0.5, row], [size[1] - 0.5, row]]])
    tangents = cv2.fisheye.undistortPoints(edges, lens.K, coefficients)[0, :, 0]
    visible = float(np.abs(tangents).min())
    widest = math.tan(math.radians(RECTIFIED_FOV_DEG) / 2)
    camera = _centred_camera(size, min(widest, visible))

    maps = cv2.fisheye.initUndistortRectifyMap(
        lens.K, coefficients, np.eye(3), camera.K, size[::-1], cv2.CV_16SC2
    )
    return camera, _remap_images(maps)


def _parse_fisheye(text: str) -> np.ndarray:
    """Return the coefficients [4] of the option --fisheye. Raises InputError."""
    return np.array(parse_numbers(text, (4,), "--fisheye 0,0,0,0"))


def _undistort_images(camera: Camera, text: str) -> Rectify:
    """Return a function that rectifies a camera's distorted images, for the same intrinsics.

    `text` is "k1,k2,p1,p2" or "k1,k2,p1,p2,k3" of OpenCV's model. Raises InputError for another
    text, and if the numbers seem to describe a fisheye lens.
    """
    coefficients = np.array(parse_numbers(text, (4, 5), "--distortion -0.37,0.2,0,0"))
    if np.abs(coefficients[2:4]).max() > MAX_TANGENTIAL:
        problem = f"p1 or p2 exceeds {MAX_TANGENTIAL} (got {text}): a fisheye lens?"
        raise InputError(problem, "--distortion", "Pass these as --fisheye")
    size = camera.size[::-1]
    maps = cv2.initUndistortRectifyMap(camera.K, coefficients, None, camera.K, size, cv2.CV_16SC2)
    return _remap_images(maps)


def _remap_images(maps: tuple[np.ndarray, np.ndarray]) -> Rectify:
    """Return a function that takes the pixels of an image from the places in OpenCV's `maps`."""

    def rectify(image: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR))

    return rectify


def parse_numbers(text: str, counts: Sequence[int], example: str) -> list[float]:
    """Return the numbers in the text of an option.

    Raises InputError unless their count is one of `counts`. The message shows the `example`.
    """
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not np.isfinite(values).all():
        option = example.split()[0]
        expected = " or ".join(map(str, counts))
        problem = f"expected {expected} numbers, got {text!r}"
        raise InputError(problem, option, f"Example: {example}")
    return values
