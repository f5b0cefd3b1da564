"""Semantic point clouds (paper eq. 6 and 7): points in metres, each with the class of its pixel.

Clouds are in the rectified camera frame: x right, y down, z forward. The factor λ of eq. 7 is a
setting of each model (`semantics`), so clouds always carry the class.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, DriveFrames, visible

if TYPE_CHECKING:
    from pipeline.clouds.settings import Clouds

# Limits in metres of the four intervals of horizontal range, see :func:`draw_by_range`.
STRATA_M = (10.0, 20.0, 40.0)
# Resolution in metres of stored coordinates: far finer than any sensor, and exact in float32 up to
# 16 km.
RESOLUTION_M = 1 / 1024


class Cloud(NamedTuple):
    """A point cloud with a class for each point."""

    xyz: np.ndarray  # float32 [P,3] in metres
    cls: np.ndarray  # trainIds uint8 [P]

    def at(self, rows: np.ndarray) -> "Cloud":
        """Return the points in some `rows`."""
        return Cloud(self.xyz[rows], self.cls[rows])


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, max_depth_m: float) -> Cloud:
    """Back-project the :func:`solid_pixels` of an image (paper eq. 6)."""
    pixels = solid_pixels(depth_m, cls, max_depth_m)
    xyz = geometry.back_project(depth_m, K)[pixels]
    return Cloud(xyz.astype(np.float32), cls[pixels].astype(np.uint8))


def solid_pixels(depth_m: np.ndarray, cls: np.ndarray, max_depth_m: float) -> np.ndarray:
    """Return which pixels become points, bool [H,W], from depth in metres and trainIds [H,W].

    Sky, void and invalid pixels (depth 0), and those beyond `max_depth_m`, do not. An encoder
    without classes gives only void: then all valid pixels become points.
    """
    pixels = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY)
    has_class = cls != classes.VOID
    if has_class.any():
        pixels &= has_class
    return pixels


def lidar_cloud(scan: np.ndarray, camera: Camera, cls: np.ndarray | None) -> Cloud:
    """Transform a scan into the camera frame; each point takes its pixel's class.

    `scan` [P,≥3] holds x, y, z in metres in the velodyne frame; `cls` [H,W] the trainIds of the
    frame's image, or None. Points outside of the image, on the sky, or hidden from it are void.
    """
    assert camera.T_cam_velo is not None
    xyz = geometry.transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        index, row, column = visible(xyz, camera)
        labels[index] = cls[row, column]
        # The sky returns no laser pulse, so such a point is on a silhouette.
        labels[labels == classes.SKY] = classes.VOID
    return Cloud(xyz.astype(np.float32), labels)


def clouds_drive(
    path: Path, kind: str, ingest: Path, perception: Path, settings: "Clouds"
) -> Summary:
    """Write the clouds of a drive, each at most `max_points` random points of a frame.

    `kind` is pseudo (from images) or lidar (from scans); `ingest` and `perception` are the drive's
    files of these stages.
    """
    counts = []
    with DriveFrames(ingest, perception, scans=kind == "lidar") as frames:
        params = frames.params | {"clouds": settings.model_dump()}
        with DriveWriter(path, stage="clouds", drive=frames.drive, params=params) as file:
            file.put("frame", frames.frame)
            file.put("time_s", frames.time_s, unit="s")
            file.append("xyz", np.empty((0, 3), np.float32), "m", "ptr")
            file.append("cls", np.empty(0, np.uint8), "trainId", "ptr")
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
    """Return a frame's random generator, which does not depend on the order of work."""
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def draw_points(
    cloud: Cloud,
    crop_m: Sequence[float] | None,
    points: int,
    rng: np.random.Generator,
    sampling: str = "uniform",
) -> Cloud:
    """Return at most `points` random points of a cloud inside of a crop, in the cloud's order.

    `crop_m` holds the left, near, right and far limit of x and z, or is None. `sampling` is uniform
    or range, see :func:`draw_by_range`.
    """
    if crop_m is not None:
        near_left = np.array(crop_m[:2])
        far_right = np.array(crop_m[2:])
        xz = cloud.xyz[:, [0, 2]]
        inside = (near_left <= xz) & (xz <= far_right)
        cloud = cloud.at(np.flatnonzero(inside.all(axis=1)))
    if sampling == "range":
        return cloud.at(draw_by_range(cloud.xyz, points, rng))
    return cloud.at(draw_rows(len(cloud.xyz), points, rng))


def draw_rows(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the rows 0..count-1 without replacement.

    They are ascending, which keeps Morton order.
    """
    if count <= limit:
        return np.arange(count)
    return np.sort(rng.choice(count, limit, replace=False, shuffle=False))


def draw_by_range(xyz: np.ndarray, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the points [P,3], equally many from each interval of STRATA_M.

    An image has few pixels far away. Where an interval has too few points, the other intervals
    share the remaining ones. Returns ascending rows, without replacement.
    """
    shuffled = rng.permutation(len(xyz))
    range_m = np.hypot(xyz[shuffled, 0], xyz[shuffled, 2])
    stratum = np.digitize(range_m, STRATA_M)

    # Number the points of each interval. Then take all first points, all second ones, and so on.
    rank = np.empty(len(xyz), np.int64)
    for number in range(len(STRATA_M) + 1):
        members = stratum == number
        rank[members] = np.arange(np.count_nonzero(members))
    by_rank = np.argsort(rank, kind="stable")
    return np.sort(shuffled[by_rank[:limit]])


def in_morton_order(cloud: Cloud) -> Cloud:
    """Return a cloud in Morton order, with coordinates rounded to multiples of RESOLUTION_M.

    Neighbours in space become neighbours in memory: kNN and sparse products are faster, and files
    compress better.
    """
    cells = np.rint(cloud.xyz / RESOLUTION_M)
    numbers = np.clip(cells + 2**20, 0, 2**21 - 1).astype(np.uint64)
    x, y, z = numbers.T
    code = _spread(x) | (_spread(y) << np.uint64(1)) | (_spread(z) << np.uint64(2))
    order = np.argsort(code, kind="stable")
    xyz = (cells[order] * RESOLUTION_M).astype(np.float32)
    return Cloud(xyz, cloud.cls[order])


def _spread(x: np.ndarray) -> np.ndarray:
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
