"""The pinhole camera of a drive or a video, and the frames that it records."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.geometry import (
    CAMERA_HEIGHT_M,
    SCANNER_HEIGHT_M,
    depth_image,
    pixels_of,
    transform,
)
from pipeline.camera.images import Crop, Size, to_metres

# largest relative difference of aspect ratios that resizing may change; KITTI's sizes need 0.01
SAME_SHAPE = 0.03
# centre of a crop below the horizon, as a share of the width; measured on KITTI's images
BELOW_HORIZON = 0.0115
OCCLUDER_RAD = 0.004
# neighbouring rings on flat ground differ by a quarter in distance only beyond 60 m
OCCLUDED_RATIO = 1.25


@dataclass(frozen=True, eq=False)
class Camera:
    """A rectified camera. Frame: x right, y down, z forward; the origin is the projection
    centre.
    """

    K: Any  # [3,3] pixels, of images of this size; None: unknown
    size: Size  # (H, W)
    height_m: float = CAMERA_HEIGHT_M  # over the road; KITTI's unless height_known
    # [4,4], points from the velodyne frame to the camera frame; None: no LiDAR
    T_cam_velo: Any = None
    horizon: float | None = None  # row of the road's horizon; None: unknown
    height_known: bool = False

    def at_height(self, height_m: float | None) -> "Camera":
        """Return the camera at a known height over the road; None: as it is."""
        return self if height_m is None else replace(self, height_m=height_m, height_known=True)

    def scaled(self, size: Size) -> "Camera":
        """Return the camera after resizing its images to `size` (H, W).

        Resizing maps the left edge -0.5 to -0.5, so centres move: ``u' = s (u + 0.5) - 0.5``.
        """
        sy, sx = size[0] / self.size[0], size[1] / self.size[1]
        K = self.K * np.array([[sx], [sy], [1.0]])
        K[0, 2] = sx * (self.K[0, 2] + 0.5) - 0.5
        K[1, 2] = sy * (self.K[1, 2] + 0.5) - 0.5
        horizon = None if self.horizon is None else sy * (self.horizon + 0.5) - 0.5
        return replace(self, K=K, size=size, horizon=horizon)

    def cropped(self, crop: Crop) -> "Camera":
        """Return the camera after cropping its images."""
        shift = np.zeros((3, 3))
        shift[:2, 2] = crop.columns.start, crop.rows.start
        horizon = None if self.horizon is None else self.horizon - crop.rows.start
        return replace(self, K=self.K - shift, size=crop.size, horizon=horizon)

    def mirrored(self) -> "Camera":
        """Return the camera of the mirrored images."""
        K = self.K.copy()
        K[0, 2] = self.size[1] - 1 - K[0, 2]
        return replace(self, K=K)

    def crop_to(self, aspect: Size) -> Crop:
        """Return the largest part of complete images with the aspect ratio of `aspect` (H, W).

        Its centre is BELOW_HORIZON below the horizon or, if that is unknown, the principal point,
        as far as the image reaches. An image whose aspect ratio differs by at most SAME_SHAPE is
        used completely.
        """
        height, width = self.size
        ratio = height * aspect[1] / (width * aspect[0])
        if max(ratio, 1 / ratio) <= 1 + SAME_SHAPE:
            return Crop(slice(0, height), slice(0, width))
        if ratio > 1:
            centre = self.K[1, 2] if self.horizon is None else self.horizon + BELOW_HORIZON * width
            return Crop(_around(centre, round(height / ratio), height), slice(0, width))
        return Crop(slice(0, height), _around(self.K[0, 2], round(width * ratio), width))


def _around(centre: float, length: int, limit: int) -> slice:
    start = min(max(round(centre + 0.5 - length / 2), 0), limit - length)
    return slice(start, start + length)


@dataclass
class Frame:
    """Sensor data and perception of one frame; None where the frame lacks it."""

    number: int  # KITTI's, or counted from 0
    time_s: float  # since the start of the drive
    image: Any = None  # RGB uint8 [H,W,3], at the size of depth and classes
    depth_m: Any = None  # [H,W] metres, rounded as in the file of stage perception; 0: none
    cls: Any = None  # trainIds uint8 [H,W]
    scan: Any = None  # float32 [P,4] in the velodyne frame: x, y, z in metres, reflectance


def camera_height(T_cam_velo: np.ndarray | None) -> float | None:
    """Return a camera's height over flat ground in metres from its calibration [4,4]; None if that
    is None.
    """
    # The scanner's height is fixed on KITTI's cars; its z points up.
    return None if T_cam_velo is None else SCANNER_HEIGHT_M + float(np.linalg.inv(T_cam_velo)[2, 3])


def scan_depth(scan: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the :func:`depth_image` float32 [H,W] of the visible points of a LiDAR scan [P,≥3],
    velodyne x, y, z.
    """
    xyz = transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    return depth_image(xyz[visible(xyz, camera)[0]], camera.K, camera.size).astype(np.float32)


def visible(xyz: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the :func:`pixels_of` the points [N,3] of a scan, in the camera frame, that the camera
    sees.

    The scanner is above the camera and looks over objects, so points behind an object project
    between those of the object. A point is hidden if another one within 0.23 degrees, about one
    ring of KITTI's scanner, is a fifth nearer.
    """
    inside, row, column = pixels_of(xyz, camera.K, camera.size)
    nearest_m = depth_image(xyz, camera.K, camera.size)
    nearest_m[nearest_m == 0] = np.inf
    reach = [max(1, round(OCCLUDER_RAD * f)) for f in (camera.K[1, 1], camera.K[0, 0])]
    # erosion is a local minimum
    nearest_m = cv2.erode(nearest_m, np.ones([2 * pixels + 1 for pixels in reach]))
    seen = xyz[inside, 2] / OCCLUDED_RATIO <= nearest_m[row, column]
    return inside[seen], row[seen], column[seen]


def write_camera(file: DriveWriter, camera: Camera) -> None:
    """Write intrinsics, and T_cam_velo if the LiDAR is calibrated, to an ingest file."""
    file.put("K", camera.K, "pixels")
    if camera.T_cam_velo is not None:
        file.put("T_cam_velo", camera.T_cam_velo, "m")


def read_camera(file: DriveReader) -> Camera:
    """Return an ingest file's camera; K is None without images and scans."""
    known = {name: file[name] for name in ("K", "T_cam_velo") if name in file}
    (height, width), T_cam_velo = file.datasets["image"].shape[1:3], known.get("T_cam_velo")
    camera = Camera(known.get("K"), (height, width), T_cam_velo=T_cam_velo)
    return camera.at_height(file.params.get("camera_height_m") or camera_height(T_cam_velo))


class DriveFrames(ExitStack):
    """The frames of a drive that have an image, or with `scans` those that have a scan, matched by
    frame number.

    A context manager on the drive's files of stages ingest and perception.
    """

    def __init__(self, ingest: Path, perception: Path, *, scans: bool = False) -> None:
        super().__init__()
        raw = self._ingest = self.enter_context(DriveReader(ingest, stage="ingest"))
        perceived = self._perception = self.enter_context(
            DriveReader(perception, stage="perception")
        )
        source, rows = (
            (raw, np.flatnonzero(raw["has_lidar"])) if scans else (perceived, slice(None))
        )
        self.drive, self.params, self._scans = raw.drive, perceived.params, scans
        self.frame = source.frame[rows]  # KITTI frame numbers, int32 [F]
        self.time_s = source.time_s[rows]  # float64 [F]
        self.camera = read_camera(raw)
        # of depth, by the height of the camera
        self.unit_error = float(perceived.attrs.get("unit_error", np.inf))

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames with image, depth and classes; or with a scan, and classes where there is an
        image.
        """
        image_row = {number: row for row, number in enumerate(self._perception.frame.tolist())}
        for number, time_s in zip(self.frame.tolist(), self.time_s.tolist(), strict=True):
            frame, row = Frame(number, time_s), image_row.get(number)
            if row is not None:
                frame.cls = self._perception.row("cls", row)
            if self._scans:
                frame.scan = self._ingest.rows_of("lidar", self._ingest.row_of(number))
            else:
                frame.image = self._ingest.row("image", self._ingest.row_of(number))
                frame.depth_m = to_metres(self._perception.row("depth_m", image_row[number]))
            yield frame
