"""Semantic point clouds (paper eq. 6 and 7): computation, sampling, and the writer of their file.

Clouds are in the rectified camera frame, metres: x right, y down, z forward. The factor λ of eq. 7 is a setting of each
model (`semantics`), so clouds always carry the class.
"""

import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveWriter
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.drive_frames import open_frames

if TYPE_CHECKING:
    from pipeline.settings.clouds import Clouds

Cloud = tuple[np.ndarray, np.ndarray]
"""xyz float32 [P,3] in metres, cls uint8 [P]."""

STRATA_M = (10.0, 20.0, 40.0)
"""Limits of the four intervals of horizontal range from which `sampling: range` draws equal numbers of points."""
RESOLUTION_M = 1 / 1024  # of stored coordinates: far finer than any sensor, and files compress better


def clouds_drive(path: Path, kind: str, ingest: Path, perception: Path, settings: "Clouds") -> dict[str, int]:
    """Write the cloud of each frame, back-projected with K⁻¹ (paper eq. 6, 7), or a scan in the camera frame.

    `kind`: pseudo (of images) or lidar (of scans); `ingest` and `perception`: the drive's files of these stages.
    """
    with open_frames(ingest, perception, scans=kind == "lidar") as frames:
        params = frames.params | {"clouds": settings.model_dump()}
        with DriveWriter(path, stage="clouds", drive=frames.drive, params=params) as file:
            clouds = (stored_cloud(frame, kind, frames.camera, frames.drive, settings) for frame in frames)
            return write(file, frames.frame, frames.time_s, clouds)


def stored_cloud(frame: Frame, kind: str, camera: Camera, drive: str, settings: "Clouds") -> Cloud:
    """Return at most `max_points` random points of a frame with quantised coordinates, in Morton order.

    `kind`: pseudo, for a frame with depth and classes, or lidar, for a frame with a scan of a calibrated sensor.
    """
    if kind == "pseudo":
        assert frame.depth_m is not None
        assert frame.cls is not None
        xyz, cls = pseudo_cloud(frame.depth_m, frame.cls, camera.K, settings.max_depth_m)
    else:
        assert frame.scan is not None
        assert camera.T_cam_velo is not None
        xyz, cls = lidar_cloud(frame.scan, camera.T_cam_velo, camera.K, frame.cls)
    drawn = sample(len(xyz), settings.max_points, frame_rng(settings.seed, drive, frame.number))
    return ordered((xyz[drawn], cls[drawn]))


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, max_depth_m: float) -> Cloud:
    """Back-project the pixels of an image with depth [H,W] in metres, 0 = invalid, and trainIds [H,W] (paper eq. 6).

    Sky, void and invalid pixels, and those beyond `max_depth_m`, give no point. If all pixels are void, as of an
    encoder without classes, they are points.
    """
    solid = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY)
    if (cls != classes.VOID).any():
        solid &= cls != classes.VOID
    return geometry.back_project(depth_m, K)[solid].astype(np.float32), cls[solid].astype(np.uint8)


def lidar_cloud(scan: np.ndarray, T_cam_velo: np.ndarray, K: np.ndarray, cls: np.ndarray | None) -> Cloud:
    """Transform a scan [P,≥3], velodyne x, y, z in metres, into the camera frame; void outside of the image or on sky.

    T_cam_velo [4,4]; K [3,3] for the size of `cls` [H,W], trainIds of the same frame's image, None without one.
    """
    xyz = geometry.transform(T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        uv, _ = geometry.project(xyz, K)
        pixel = np.rint(np.nan_to_num(uv, nan=-1.0)).clip(-1, max(cls.shape)).astype(np.int64)
        inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] < cls.shape[1]) & (pixel[:, 1] < cls.shape[0])
        labels[inside] = cls[pixel[inside, 1], pixel[inside, 0]]
        labels[labels == classes.SKY] = classes.VOID  # the sky returns no laser pulse: a point at a silhouette
    return xyz.astype(np.float32), labels


def ordered(cloud: Cloud) -> Cloud:
    """Return a cloud with quantised coordinates, in Morton order."""
    xyz, cls = quantise(cloud[0]), cloud[1]
    order = morton_order(xyz)
    return xyz[order], cls[order]


def write(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, clouds: Iterable[Cloud]) -> dict[str, int]:
    """Write frame numbers [F], times [F] and clouds of a drive; return its numbers of frames and points."""
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    file.append("xyz", np.empty((0, 3), np.float32), "m", "ptr")
    file.append("cls", np.empty(0, np.uint8), "trainId", "ptr")
    counts = []
    for xyz, cls in clouds:
        file.append("xyz", xyz)
        file.append("cls", cls)
        counts.append(len(xyz))
    file.put_pointers("ptr", counts, unit="row")
    return {"frames": len(counts), "points": sum(counts)}


def check_not_empty(summaries: Mapping[str, Mapping[str, int]], splits: Mapping[str, str]) -> None:
    """Raise InputError if a split has frames but no point in any of them; drives that lack images or scans may.

    `summaries`: drive → numbers of frames and points, as :func:`write` returns them; `splits`: drive → its split.
    """
    for split in dict.fromkeys(splits.values()):
        drives = [summary for drive, summary in summaries.items() if splits[drive] == split]
        frames = sum(summary["frames"] for summary in drives)
        if frames and not sum(summary["points"] for summary in drives):
            raise InputError(f"no point in any of the {frames} frames of the {split} drives")


def frame_rng(seed: int, drive: str, frame: int) -> np.random.Generator:
    """Return a random generator that depends only on seed, drive and frame number, not on the order of work."""
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def sample_points(
    cloud: Cloud,
    left_near_right_far_m: tuple[float, float, float, float] | None,
    points: int,
    rng: np.random.Generator,
    sampling: str = "uniform",
) -> Cloud:
    """Return at most `points` random points of a cloud inside the crop (all without one), in the cloud's order.

    The crop limits x and z of the camera frame. `sampling`: uniform | range, see :func:`sample_by_range`.
    """
    xyz, cls = cloud
    inside = np.arange(len(xyz))
    if left_near_right_far_m is not None:
        xz, bounds = xyz[:, [0, 2]], np.array(left_near_right_far_m)
        inside = np.flatnonzero(((bounds[:2] <= xz) & (xz <= bounds[2:])).all(axis=1))
    drawn = sample_by_range(xyz[inside], points, rng) if sampling == "range" else sample(len(inside), points, rng)
    return xyz[inside[drawn]], cls[inside[drawn]]


def sample(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the indices 0..count-1 without replacement, ascending, which keeps Morton order."""
    if count <= limit:
        return np.arange(count)
    drawn = np.zeros(count, bool)
    drawn[rng.choice(count, limit, replace=False, shuffle=False)] = True
    return np.flatnonzero(drawn)


def sample_by_range(xyz: np.ndarray, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the points [P,3] without replacement, equally many from each interval of STRATA_M.

    An image has few pixels far away. Where an interval has too few points, the others share the rest. Returns indices,
    ascending.
    """
    shuffled = rng.permutation(len(xyz))
    stratum = np.digitize(np.hypot(xyz[shuffled, 0], xyz[shuffled, 2]), STRATA_M)
    rank = np.empty(len(xyz), np.int64)  # of each point in its interval
    for number in range(len(STRATA_M) + 1):
        members = stratum == number
        rank[members] = np.arange(np.count_nonzero(members))
    return np.sort(shuffled[np.argsort(rank, kind="stable")[:limit]])


def quantise(xyz: np.ndarray) -> np.ndarray:
    """Round coordinates to multiples of RESOLUTION_M, which are exact in float32 up to 16 km."""
    return (np.rint(xyz / RESOLUTION_M) * RESOLUTION_M).astype(np.float32)


def morton_order(xyz: np.ndarray) -> np.ndarray:
    """Return the permutation [P] that sorts points [P,3] along a Z-order curve.

    Neighbours in space become neighbours in memory: kNN and sparse products are faster, files compress better.
    """
    grid = np.clip(np.floor(xyz / RESOLUTION_M) + 2**20, 0, 2**21 - 1).astype(np.uint64)
    code = _spread(grid[:, 0]) | (_spread(grid[:, 1]) << np.uint64(1)) | (_spread(grid[:, 2]) << np.uint64(2))
    return np.argsort(code, kind="stable")


def _spread(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits between the 21 low bits of each number."""
    masks = (0x1F00000000FFFF, 0x1F0000FF0000FF, 0x100F00F00F00F00F, 0x10C30C30C30C30C3, 0x1249249249249249)
    for shift, mask in zip((32, 16, 8, 4, 2), masks, strict=True):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
