"""Describe the pinhole camera of a drive or a video, and read the frames that it records."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.errors import DamagedFile
from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.geometry import (
    CAMERA_HEIGHT_M,
    SCANNER_HEIGHT_M,
    depth_image,
    pixels_of,
    transform,
)
from pipeline.camera.images import Crop, Size, to_metres

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


def write_camera(file: DriveWriter, camera: Camera) -> None:
    """Write a camera's intrinsics to an ingest file, and crop and T_cam_velo if it has them."""
    file.put("K", camera.K, "pixels")
    if camera.crop:
        ranges = zip((camera.crop.rows, camera.crop.columns), camera.crop.image_size, strict=True)
        crop = [[used.start, used.stop, length] for used, length in ranges]
        file.put("crop", np.array(crop, np.int32), "pixels")
    if camera.T_cam_velo is not None:
        file.put("T_cam_velo", camera.T_cam_velo, "m")


def read_camera(file: DriveReader) -> Camera:
    """Return the camera of an ingest file."""
    height, width = file.datasets["image"].shape[1:3]
    T_cam_velo = None
    if "T_cam_velo" in file:
        T_cam_velo = file["T_cam_velo"]
    crop = None
    if "crop" in file:
        (top, bottom, full_height), (left, right, full_width) = file["crop"].tolist()
        crop = Crop(slice(top, bottom), slice(left, right), (full_height, full_width))
    camera = Camera(file["K"], (height, width), T_cam_velo=T_cam_velo, crop=crop)
    return camera.at_height(file.params.get("camera_height_m") or camera_height(T_cam_velo))


class DriveFrames(ExitStack):
    """The frames of a drive that have an image, or with `scans` those that have a scan.

    This is a context manager that opens the drive's files of stages ingest and perception. Frames
    of both files are matched by their numbers.
    """

    def __init__(self, ingest: Path, perception: Path, *, scans: bool = False) -> None:
        super().__init__()
        self._ingest = self.enter_context(DriveReader(ingest, stage="ingest"))
        self._perception = self.enter_context(DriveReader(perception, stage="perception"))
        self._scans = scans

        # Stage ingest lists the frames with a scan, stage perception those with an image.
        self.frame = self._perception.frame  # KITTI frame numbers, int32 [F]
        self.time_s = self._perception.time_s  # float64 [F]
        if scans:
            rows = np.flatnonzero(self._ingest["has_lidar"])
            self.frame = self._ingest.frame[rows]
            self.time_s = self._ingest.time_s[rows]

        self.drive = self._ingest.drive
        self.params = self._perception.params
        self.camera = read_camera(self._ingest)
        # Largest plausible factor between the camera's known height and its height by depth. Depth
        # beyond it is in another unit.
        self.unit_error = float(self._perception.attrs.get("unit_error", np.inf))

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames with image, depth and classes, or with a scan and classes of its image.

        A frame with a scan may lack an image, and so classes.
        """
        image_row = {number: row for row, number in enumerate(self._perception.frame.tolist())}
        for number, time_s in zip(self.frame.tolist(), self.time_s.tolist(), strict=True):
            frame = Frame(number, time_s)
            ingest_row = self._ingest.row_of(number)
            if number in image_row:
                frame.cls = self._perception.row("cls", image_row[number])
            if self._scans:
                frame.scan = self._ingest.rows_of("lidar", ingest_row)
            else:
                frame.image = self._ingest.row("image", ingest_row)
                frame.depth_m = to_metres(self._perception.row("depth_m", image_row[number]))
            yield frame
