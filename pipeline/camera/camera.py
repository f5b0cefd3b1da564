"""Describe the pinhole camera of a drive or a video, and the frames that it records."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from pipeline.base.errors import DamagedFile
from pipeline.camera.geometry import (
    CAMERA_HEIGHT_M,
    SCANNER_HEIGHT_M,
    depth_image,
    pixels_of,
    transform,
)
from pipeline.camera.images import Crop, Size

# Largest relative difference between two aspect ratios that count as equal, so that an image is
# resized and not cropped. KITTI's image sizes differ by 0.01.
SAME_SHAPE = 0.03
# Distance of a crop's centre below the horizon, as a share of the image's width. It was measured on
# KITTI's images.
BELOW_HORIZON = 0.0115
# Half the width in radians of the window in which a nearer point hides others. It is 0.23 degrees,
# about the distance between two rings of KITTI's scanner.
OCCLUDER_RAD = 0.004
# A point is hidden if its depth exceeds that of a point before it by more than this factor. On flat
# ground, neighbouring rings differ by a quarter in distance only beyond 60 m.
OCCLUDED_RATIO = 1.25


@dataclass(frozen=True, eq=False)
class Camera:
    """A rectified camera.

    Its frame is x right, y down, z forward, and has its origin in the projection centre.
    """

    K: np.ndarray  # intrinsics [3,3] in pixels, for images of `size`
    size: Size  # (H, W)
    height_m: float = CAMERA_HEIGHT_M  # height over the road
    T_cam_velo: np.ndarray | None = None  # [4,4]; None without a LiDAR
    horizon: float | None = None  # image row of the road's horizon; None if it is unknown
    height_known: bool = False  # otherwise, the height is that of KITTI's cameras
    crop: Crop | None = None  # the part of complete images that is left; None if it is unknown

    def at_height(self, height_m: float | None) -> "Camera":
        """Return the camera at a known height over the road, or the same camera for None."""
        if height_m is None:
            return self
        return replace(self, height_m=height_m, height_known=True)

    def scaled(self, size: Size) -> "Camera":
        """Return the camera after resizing its images to `size` (H, W).

        Integer coordinates are pixel centres, so an image starts at -0.5, and a coordinate u
        becomes ``s (u + 0.5) - 0.5``.
        """
        scale_v = size[0] / self.size[0]
        scale_u = size[1] / self.size[1]
        K = self.K * np.array([[scale_u], [scale_v], [1.0]])
        K[0, 2] = scale_u * (self.K[0, 2] + 0.5) - 0.5
        K[1, 2] = scale_v * (self.K[1, 2] + 0.5) - 0.5
        horizon = self.horizon
        if horizon is not None:
            horizon = scale_v * (horizon + 0.5) - 0.5
        return replace(self, K=K, size=size, horizon=horizon)

    def cropped(self, crop: Crop) -> "Camera":
        """Return the camera after cropping its images."""
        shift = np.zeros((3, 3))
        shift[0, 2] = crop.columns.start
        shift[1, 2] = crop.rows.start
        horizon = self.horizon
        if horizon is not None:
            horizon = horizon - crop.rows.start
        return replace(self, K=self.K - shift, size=crop.size, horizon=horizon, crop=crop)

    def mirrored(self) -> "Camera":
        """Return the camera of the mirrored images."""
        K = self.K.copy()
        K[0, 2] = self.size[1] - 1 - K[0, 2]
        return replace(self, K=K)

    def crop_to(self, aspect: Size) -> Crop:
        """Return the largest crop of this camera's images with the aspect ratio of `aspect` (H, W).

        An image that is too high is cropped around a row that is BELOW_HORIZON below the horizon,
        or around the principal point if the horizon is unknown. An image that is too wide is
        cropped around the principal point. A crop that would reach beyond the image is moved into
        it. If the aspect ratios differ by at most SAME_SHAPE, the crop is the complete image.
        """
        height, width = self.size
        rows = slice(0, height)
        columns = slice(0, width)
        if same_shape(self.size, aspect):
            return Crop(rows, columns, self.size)

        # With a ratio above 1, the image is higher than the aspect ratio allows.
        ratio = height * aspect[1] / (width * aspect[0])
        if ratio > 1:
            centre = self.K[1, 2]
            if self.horizon is not None:
                centre = self.horizon + BELOW_HORIZON * width
            rows = _range_around(centre, round(height / ratio), height)
        else:
            columns = _range_around(self.K[0, 2], round(width * ratio), width)
        return Crop(rows, columns, self.size)


def same_shape(size: Size, other: Size) -> bool:
    """Return whether the aspect ratios of two sizes (H, W) differ by at most SAME_SHAPE."""
    ratio = size[0] * other[1] / (size[1] * other[0])
    return max(ratio, 1 / ratio) <= 1 + SAME_SHAPE


def _range_around(centre: float, length: int, limit: int) -> slice:
    """Return the range of `length` pixels around a centre, moved to lie between 0 and `limit`."""
    start = round(centre + 0.5 - length / 2)
    start = min(max(start, 0), limit - length)
    return slice(start, start + length)


@dataclass
class Frame:
    """Sensor data and perception of one frame. A field is None if the frame lacks it.

    A dataset may set a field to a function without arguments that reads and returns it.
    """

    number: int  # KITTI's frame number, or one counted from 0
    time_s: float  # time since the start of the drive
    image: Any = None  # RGB uint8 [H,W,3]
    depth_m: Any = None  # [H,W] in metres, rounded as in the file of stage perception; 0: no depth
    cls: Any = None  # trainIds uint8 [H,W]
    scan: Any = None  # float32 [P,4] in the velodyne frame: x, y, z in metres, reflectance

    def read_fields(self) -> dict[str, DamagedFile]:
        """Replace the fields that are functions by what they read, None for a damaged file.

        Returns name of a field → exception for the damaged files.
        """
        damaged = {}
        for name in ("image", "depth_m", "cls", "scan"):
            field = getattr(self, name)
            if not callable(field):
                continue
            content = None
            try:
                content = field()
            except DamagedFile as fault:
                damaged[name] = fault
            setattr(self, name, content)
        return damaged


def camera_height(T_cam_velo: np.ndarray | None) -> float | None:
    """Return a camera's height in metres over flat ground by its calibration [4,4].

    It is None without a calibration.
    """
    if T_cam_velo is None:
        return None
    # The height of the scanner is known, and the z axis of its frame points up.
    T_velo_cam = np.linalg.inv(T_cam_velo)
    return SCANNER_HEIGHT_M + float(T_velo_cam[2, 3])


def scan_depth(scan: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the depth of a scan's visible points in an image, float32 [H,W] in metres.

    A pixel without a point has a depth of 0. `scan` [P,≥3] holds x, y, z in the velodyne frame.
    """
    assert camera.T_cam_velo is not None, "the camera belongs to a scanner"
    xyz = transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    index, _, _ = find_visible(xyz, camera)
    return depth_image(xyz[index], camera.K, camera.size).astype(np.float32)


def find_visible(xyz: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points of a scan that the camera sees: indices [M], pixels' rows and columns.

    `xyz` [N,3] holds the points in the camera frame. The scanner is above the camera and looks over
    objects, so that points behind an object are projected between the points of this object. A
    point is hidden if another point within OCCLUDER_RAD has a depth that is smaller by a factor of
    more than OCCLUDED_RATIO.
    """
    index, row, column = pixels_of(xyz, camera.K, camera.size)
    depth_m = depth_image(xyz, camera.K, camera.size)
    depth_m[depth_m == 0] = np.inf

    # The depth of the nearest point around each pixel; erosion is a local minimum.
    reach_v = max(1, round(OCCLUDER_RAD * camera.K[1, 1]))
    reach_u = max(1, round(OCCLUDER_RAD * camera.K[0, 0]))
    nearest_m = cv2.erode(depth_m, np.ones([2 * reach_v + 1, 2 * reach_u + 1]))

    in_front = xyz[index, 2] / OCCLUDED_RATIO <= nearest_m[row, column]
    return index[in_front], row[in_front], column[in_front]
