"""A frame's semantic point cloud (paper eq. 6 and 7), as it is stored, and the writer of its file.

Clouds are in the rectified camera frame, metres: x right, y down, z forward. The factor λ of eq. 7 is a model's own
setting (`semantics`), so clouds always carry the class.
"""

import zlib
from collections.abc import Iterable, Mapping

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveWriter
from pipeline.camera import classes, geometry

Cloud = tuple[np.ndarray, np.ndarray]
"""xyz float32 [P,3] in metres, cls uint8 [P]."""

RESOLUTION_M = 1 / 1024  # coordinates are stored in steps of about a millimetre: far below any sensor, and files shrink


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, max_depth_m: float) -> Cloud:
    """Lift an image's pixels into 3D.

    Args:
        depth_m: [H,W] metres along the optical axis, 0 = invalid.
        cls: [H,W] Cityscapes trainIds.
        K: [3,3] intrinsics for this size.
        max_depth_m: pixels farther away give no point.

    Returns: xyz float32 [P,3], cls uint8 [P]. Sky, void and invalid pixels give no point.
    """
    solid = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY) & (cls != classes.VOID)
    return geometry.back_project(depth_m, K)[solid].astype(np.float32), cls[solid].astype(np.uint8)


def lidar_cloud(scan: np.ndarray, T_cam_velo: np.ndarray, K: np.ndarray, cls: np.ndarray | None) -> Cloud:
    """Bring a scan into the camera frame and give each point the class of the pixel that it falls on.

    Args:
        scan: [P,≥3] velodyne x, y, z in metres; all around the car.
        T_cam_velo: [4,4].
        K: [3,3] intrinsics for the size of `cls`.
        cls: [H,W] trainIds of the same frame's image, or None if there is none.

    Returns: xyz float32 [P,3], cls uint8 [P]; void for points outside the image or on sky pixels.
    """
    xyz = geometry.transform(T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        uv, _ = geometry.project(xyz, K)
        pixel = np.rint(np.nan_to_num(uv, nan=-1.0)).clip(-1, max(cls.shape)).astype(np.int64)
        inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] < cls.shape[1]) & (pixel[:, 1] < cls.shape[0])
        labels[inside] = cls[pixel[inside, 1], pixel[inside, 0]]
        labels[labels == classes.SKY] = classes.VOID  # no laser returns from the sky: a silhouette
    return xyz.astype(np.float32), labels


def stored(cloud: Cloud, max_points: int, rng: np.random.Generator) -> Cloud:
    """Return a cloud as it is stored: at most `max_points`, drawn by `rng`, on the grid, in Morton order."""
    xyz, cls = cloud
    chosen = sample(len(xyz), max_points, rng)
    return ordered((xyz[chosen], cls[chosen]))


def ordered(cloud: Cloud) -> Cloud:
    """Return a cloud on the grid, in Morton order."""
    xyz, cls = quantise(cloud[0]), cloud[1]
    order = morton_order(xyz)
    return xyz[order], cls[order]


def write(file: DriveWriter, frame: np.ndarray, time_s: np.ndarray, clouds: Iterable[Cloud]) -> dict[str, int]:
    """Write a drive's clouds file, data/clouds/<kind>/<drive>.h5; return how many frames and points it holds.

    Args:
        frame: KITTI frame numbers [F]; time_s: their times [F].
        clouds: of each frame its cloud, as it is stored.
    """
    file.put("frame", np.asarray(frame, np.int32))
    file.put("time_s", time_s, unit="s")
    file.append("xyz", np.empty((0, 3), np.float32), unit="m")
    file.append("cls", np.empty(0, np.uint8), unit="trainId")
    counts = []
    for xyz, cls in clouds:
        file.append("xyz", xyz)
        file.append("cls", cls)
        counts.append(len(xyz))
    file.put_pointers("ptr", counts, unit="row")
    return {"frames": len(counts), "points": sum(counts)}


def check_any(summaries: Mapping[str, Mapping[str, int]], splits: Mapping[str, str]) -> None:
    """Raise InputError if all frames of a split's drives together hold no point: nothing to learn of, or to judge by.

    A frame without points is one in which nothing was seen; a drive without frames was recorded without what they take.

    Args:
        summaries: drive → what :func:`write`, or a writer of graphs, returned.
        splits: drive → its split.
    """
    for split in dict.fromkeys(splits.values()):
        of_split = [summary for drive, summary in summaries.items() if splits[drive] == split]
        frames = sum(summary["frames"] for summary in of_split)
        if frames and not sum(summary["points"] for summary in of_split):
            raise InputError(f"no point in any of the {frames} frames of the {split} drives")


def frame_rng(seed: int, drive: str, frame: int) -> np.random.Generator:
    """Return a generator that depends on the frame alone, so that no result depends on the order of work."""
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def cropped(xyz: np.ndarray, left_near_right_far_m: tuple[float, float, float, float] | None) -> np.ndarray:
    """Return the indices of the points [P,3] whose x and z (camera frame) lie in the crop; all if there is none."""
    if left_near_right_far_m is None:
        return np.arange(len(xyz))
    xz, bounds = xyz[:, [0, 2]], np.array(left_near_right_far_m)
    return np.flatnonzero(((bounds[:2] <= xz) & (xz <= bounds[2:])).all(axis=1))


def chosen_points(
    cloud: Cloud, left_near_right_far_m: tuple[float, float, float, float] | None, points: int, rng: np.random.Generator
) -> Cloud:
    """Return at most `points` of a cloud's points that lie in the crop, drawn by `rng`, in the cloud's order."""
    xyz, cls = cloud
    inside = cropped(xyz, left_near_right_far_m)
    chosen = inside[sample(len(inside), points, rng)]
    return xyz[chosen], cls[chosen]


def sample(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Return at most `limit` of the indices 0..count-1, drawn without replacement, ascending: Morton order survives."""
    if count <= limit:
        return np.arange(count)
    chosen = np.zeros(count, bool)
    chosen[rng.choice(count, limit, replace=False, shuffle=False)] = True
    return np.flatnonzero(chosen)


def quantise(xyz: np.ndarray) -> np.ndarray:
    """Round coordinates to multiples of RESOLUTION_M, exact in float32 up to 16 km."""
    return (np.rint(xyz / RESOLUTION_M) * RESOLUTION_M).astype(np.float32)


def morton_order(xyz: np.ndarray) -> np.ndarray:
    """Return the permutation [P] that sorts points [P,3] along a Z-order curve.

    Neighbours in space become neighbours in memory: kNN and sparse products run faster and files compress better.
    """
    grid = np.clip(np.floor(xyz / RESOLUTION_M) + 2**20, 0, 2**21 - 1).astype(np.uint64)
    code = _spread(grid[:, 0]) | (_spread(grid[:, 1]) << np.uint64(1)) | (_spread(grid[:, 2]) << np.uint64(2))
    return np.argsort(code, kind="stable")


def _spread(x: np.ndarray) -> np.ndarray:
    """Put two zero bits between the 21 low bits of each number (the usual bit trick)."""
    for shift, mask in (
        (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):  # fmt: skip
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
