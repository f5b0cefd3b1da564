"""Semantic point clouds (paper eq. 6 and 7): points in metres, each with the class of its pixel.

Clouds are in the rectified camera frame: x right, y down, z forward. The factor λ of eq. 7 is a
setting of each model (`semantics`), so clouds always carry the class.
"""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, DriveFrames, visible

if TYPE_CHECKING:
    from pipeline.clouds.settings import Clouds

Cloud = tuple[np.ndarray, np.ndarray]  # xyz float32 [P,3] in metres, cls uint8 [P] (trainIds)

STRATA_M = (10.0, 20.0, 40.0)  # limits of the four intervals of horizontal range, see draw_by_range
# of stored coordinates: far finer than any sensor, and exact in float32 up to 16 km
RESOLUTION_M = 1 / 1024


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, max_depth_m: float) -> Cloud:
    """Back-project the :func:`solid` pixels of an image (paper eq. 6)."""
    pixels = solid(depth_m, cls, max_depth_m)
    return geometry.back_project(depth_m, K)[pixels].astype(np.float32), cls[pixels].astype(
        np.uint8
    )


def solid(depth_m: np.ndarray, cls: np.ndarray, max_depth_m: float) -> np.ndarray:
    """Return which pixels bool [H,W] are points, from depth [H,W] in metres, 0 = invalid, and
    trainIds [H,W].

    Sky, void and invalid pixels, and those beyond `max_depth_m`, are none. If all pixels are void,
    as of an encoder without classes, they are points.
    """
    pixels = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY)
    return pixels & (cls != classes.VOID) if (cls != classes.VOID).any() else pixels


def lidar_cloud(scan: np.ndarray, camera: Camera, cls: np.ndarray | None) -> Cloud:
    """Transform a scan [P,≥3], velodyne x, y, z in metres, into the camera frame; each point takes
    its pixel's class.

    `cls` [H,W]: trainIds of the frame's image, or None. Points outside of it, on the sky, or hidden
    from it are void.
    """
    assert camera.T_cam_velo is not None
    xyz = geometry.transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        seen, row, column = visible(xyz, camera)
        labels[seen] = cls[row, column]
        # the sky returns no laser pulse: a point at a silhouette
        labels[labels == classes.SKY] = classes.VOID
    return xyz.astype(np.float32), labels


def clouds_drive(
    path: Path, kind: str, ingest: Path, perception: Path, settings: "Clouds"
) -> Summary:
    """Write the clouds of a drive, each at most `max_points` random points of a frame.

    `kind`: pseudo (of images) or lidar (of scans); `ingest` and `perception`: the drive's files of
    these stages.
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
                    xyz, cls = lidar_cloud(frame.scan, frames.camera, frame.cls)
                else:
                    xyz, cls = pseudo_cloud(
                        frame.depth_m, frame.cls, frames.camera.K, settings.max_depth_m
                    )
                drawn = draw(
                    len(xyz),
                    settings.max_points,
                    frame_rng(settings.seed, frames.drive, frame.number),
                )
                xyz, cls = ordered((xyz[drawn], cls[drawn]))
                file.append("xyz", xyz)
                file.append("cls", cls)
                counts.append(len(xyz))
            file.put_pointers("ptr", counts, unit="row")
    return {"frames": len(counts), "points": sum(counts)}


def frame_rng(seed: int, drive: str, frame: int) -> np.random.Generator:
    """Return a random generator that depends only on seed, drive and frame number, not on the order
    of work.
    """
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def draw_points(
    cloud: Cloud,
    crop_m: Sequence[float] | None,
    points: int,
    rng: np.random.Generator,
    sampling: str = "uniform",
) -> Cloud:
    """Return at most `points` random points of a cloud inside the crop (all without one), in the
    cloud's order.

    `crop_m`: left, near, right and far limit of x and z. `sampling`: uniform | range, see
    :func:`draw_by_range`.
    """
    xyz, cls = cloud
    inside = np.arange(len(xyz))
    if crop_m is not None:
        xz, bounds = xyz[:, [0, 2]], np.array(crop_m)
        inside = np.flatnonzero(((bounds[:2] <= xz) & (xz <= bounds[2:])).all(axis=1))
    drawn = (
        draw_by_range(xyz[inside], points, rng)
        if sampling == "range"
        else draw(len(inside), points, rng)
    )
    return xyz[inside[drawn]], cls[inside[drawn]]


def draw(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the indices 0..count-1 without replacement, ascending, which keeps
    Morton order.
    """
    if count <= limit:
        return np.arange(count)
    return np.sort(rng.choice(count, limit, replace=False, shuffle=False))


def draw_by_range(xyz: np.ndarray, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the points [P,3] without replacement, equally many from each interval
    of STRATA_M.

    An image has few pixels far away. Where an interval has too few, others share the rest. Returns
    ascending indices.
    """
    shuffled = rng.permutation(len(xyz))
    stratum = np.digitize(np.hypot(xyz[shuffled, 0], xyz[shuffled, 2]), STRATA_M)
    rank = np.empty(len(xyz), np.int64)  # of each point in its interval
    for number in range(len(STRATA_M) + 1):
        members = stratum == number
        rank[members] = np.arange(np.count_nonzero(members))
    return np.sort(shuffled[np.argsort(rank, kind="stable")[:limit]])


def ordered(cloud: Cloud) -> Cloud:
    """Return a cloud in Morton order, with coordinates rounded to multiples of RESOLUTION_M."""
    # Neighbours in space become neighbours in memory: kNN and sparse products are faster, files
    # compress better.
    cells = np.rint(cloud[0] / RESOLUTION_M)
    x, y, z = (_spread(axis) for axis in np.clip(cells + 2**20, 0, 2**21 - 1).astype(np.uint64).T)
    order = np.argsort(x | (y << np.uint64(1)) | (z << np.uint64(2)), kind="stable")
    return (cells[order] * RESOLUTION_M).astype(np.float32), cloud[1][order]


def _spread(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits between the 21 low bits of each number."""
    masks = (
        0x1F00000000FFFF,
        0x1F0000FF0000FF,
        0x100F00F00F00F00F,
        0x10C30C30C30C30C3,
        0x1249249249249249,
    )
    for shift, mask in zip((32, 16, 8, 4, 2), masks, strict=True):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
