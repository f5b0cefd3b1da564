"""Make semantic point clouds (paper eq. 6 and 7) from images or scans, and choose their points.

A point is in metres and has the class of its pixel. Clouds are in the rectified camera frame: x
right, y down, z forward. Clouds always have classes. How much they count, the factor λ of eq. 7, is
a setting of each model (`semantics`).
"""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.summary import Summary
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, find_visible
from pipeline.clouds.cloud_file import create_clouds
from pipeline.perception.drive_frames import DriveFrames

if TYPE_CHECKING:
    from pipeline.clouds.settings import Clouds

# Resolution in metres of stored coordinates. It is far finer than that of any sensor, and multiples
# of it are exact in float32 up to 16 km.
RESOLUTION_M = 1 / 1024


class Cloud(NamedTuple):
    """A point cloud with a class for each point."""

    xyz: np.ndarray  # float32 [P,3] in metres
    cls: np.ndarray  # trainIds uint8 [P]

    def at(self, rows: np.ndarray) -> "Cloud":
        """Return the points in some `rows`."""
        return Cloud(self.xyz[rows], self.cls[rows])


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, max_depth_m: float) -> Cloud:
    """Back-project the pixels of an image that become points (paper eq. 6).

    `depth_m` [H,W] is in metres, `cls` [H,W] holds trainIds, and `K` [3,3] the intrinsics.
    """
    pixels = solid_pixels(depth_m, cls, max_depth_m)
    xyz = geometry.back_project(depth_m, K)[pixels]
    return Cloud(xyz.astype(np.float32), cls[pixels].astype(np.uint8))


def solid_pixels(depth_m: np.ndarray, cls: np.ndarray, max_depth_m: float) -> np.ndarray:
    """Return which pixels become points, bool [H,W], from depth in metres and trainIds [H,W].

    Pixels without a depth (0), beyond `max_depth_m`, on the sky or without a class (void) do not
    become points. An encoder without classes gives only void. With such an encoder, all pixels up
    to `max_depth_m` become points.
    """
    pixels = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY)
    has_class = cls != classes.VOID
    if has_class.any():
        pixels &= has_class
    return pixels


def lidar_cloud(scan: np.ndarray, camera: Camera, cls: np.ndarray | None) -> Cloud:
    """Transform a scan into the camera frame, and give each point the class of its pixel.

    `scan` [P,≥3] holds x, y, z in metres in the velodyne frame. `cls` [H,W] holds the trainIds of
    the frame's image, or is None. Points that are outside of the image, hidden from the camera, or
    on the sky are void.
    """
    assert camera.T_cam_velo is not None, "the camera belongs to a scanner"
    xyz = geometry.transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        index, row, column = find_visible(xyz, camera)
        labels[index] = cls[row, column]
        # The sky returns no laser pulse, so a point with this class is on the edge of an object.
        labels[labels == classes.SKY] = classes.VOID
    return Cloud(xyz.astype(np.float32), labels)


def clouds_drive(
    path: Path, kind: str, ingest: Path, perception: Path, settings: "Clouds"
) -> Summary:
    """Write the clouds of a drive, one per frame, with at most `max_points` random points each.

    `kind` is pseudo (from images) or lidar (from scans). `ingest` and `perception` are the drive's
    files of these stages.
    """
    counts = []
    with DriveFrames(ingest, perception, scans=kind == "lidar") as frames:
        params = frames.params | {"clouds": settings.model_dump()}
        with create_clouds(path, drive=frames.drive, params=params) as file:
            file.put("frame", frames.frame)
            file.put("time_s", frames.time_s, unit="s")
            # These calls create the datasets, also in the file of a drive without frames. Dataset
            # "ptr", which is written at the end, has the rows where frames begin.
            file.append("xyz", np.empty((0, 3), np.float32), unit="m", pointer="ptr")
            file.append("cls", np.empty(0, np.uint8), unit="trainId", pointer="ptr")
            for frame in frames:
                if kind == "lidar":
                    cloud = lidar_cloud(frame.scan, frames.camera, frame.cls)
                else:
                    cloud = pseudo_cloud(
                        frame.depth_m, frame.cls, frames.camera.K, settings.max_depth_m
                    )
                rng = frame_rng(settings.seed, frames.drive, frame.number)
                rows = draw_rows(len(cloud.xyz), settings.max_points, rng)
                cloud = in_morton_order(cloud.at(rows))
                file.append("xyz", cloud.xyz)
                file.append("cls", cloud.cls)
                counts.append(len(cloud.xyz))
            file.put_pointers("ptr", counts, unit="row")
    return {"frames": len(counts), "points": sum(counts)}


def frame_rng(seed: int, drive: str, frame: int) -> np.random.Generator:
    """Return a frame's random generator, which is the same in whatever order frames are made."""
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def draw_points(
    cloud: Cloud,
    crop_m: Sequence[float] | None,
    points: int,
    rng: np.random.Generator,
) -> Cloud:
    """Return at most `points` random points of a cloud inside of a crop, in the cloud's order.

    `crop_m` holds the limits left, near, right and far, of which left and right are limits of x,
    near and far limits of z. None is no crop.
    """
    if crop_m is not None:
        lowest = np.array(crop_m[:2])
        highest = np.array(crop_m[2:])
        xz = cloud.xyz[:, [0, 2]]
        inside = (lowest <= xz) & (xz <= highest)
        cloud = cloud.at(np.flatnonzero(inside.all(axis=1)))
    return cloud.at(draw_rows(len(cloud.xyz), points, rng))


def draw_rows(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the rows 0..count-1 without replacement.

    The rows are ascending, which keeps the points in Morton order.
    """
    if count <= limit:
        return np.arange(count)
    return np.sort(rng.choice(count, limit, replace=False, shuffle=False))


def in_morton_order(cloud: Cloud) -> Cloud:
    """Return a cloud in Morton order, with coordinates rounded to multiples of RESOLUTION_M.

    In this order, neighbours in space are neighbours in memory, so kNN and sparse products are
    faster, and files compress better.
    """
    # A Morton code interleaves the bits of three numbers, here of 21 bits each.
    cells = np.rint(cloud.xyz / RESOLUTION_M)
    numbers = np.clip(cells + 2**20, 0, 2**21 - 1).astype(np.uint64)
    x, y, z = numbers.T
    code = _spread_bits(x) | (_spread_bits(y) << np.uint64(1)) | (_spread_bits(z) << np.uint64(2))
    order = np.argsort(code, kind="stable")
    xyz = (cells[order] * RESOLUTION_M).astype(np.float32)
    return Cloud(xyz, cloud.cls[order])


def _spread_bits(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits between the 21 low bits of each number."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
