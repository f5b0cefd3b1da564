"""A synthetic street in the layout that stage ingest writes: ground, a wall on either side, sky; a few kilobytes."""

from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import back_project, rays
from pipeline.camera.images import to_units
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.kitti.ingest_file import ingest_drive
from pipeline.kitti.oxts import make_rows
from pipeline.settings.ingest import Reading

SIZE = (32, 64)
K = np.array([[40.0, 0.0, 31.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]])
# velodyne x forward, y left, z up → camera x right, y down, z forward, with a small offset
T_CAM_VELO = np.array([[0.0, -1, 0, 0.0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])
CAMERA = Camera(K, SIZE)


def scene(frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return image uint8 [H,W,3], depth [H,W] in metres (0 in the sky) and classes uint8 [H,W] of a frame."""
    x, y, _ = np.moveaxis(rays(K, SIZE), -1, 0)
    half_width = 4 + 2 * np.sin(frame)
    with np.errstate(divide="ignore"):
        ground = np.where(y > 0, CAMERA_HEIGHT_M / y, np.inf)
        wall = np.where(y > -0.2, half_width / np.abs(x), np.inf)
    depth = np.minimum(ground, wall)
    cls = np.where(ground < wall, classes.ROAD, classes.BUILDING)
    cls[depth > 60] = classes.SKY
    depth[depth > 60] = 0
    rng = np.random.default_rng(frame)
    image = classes.COLOURS[cls] + rng.integers(0, 20, (*SIZE, 1), dtype=np.uint8)
    return image.astype(np.uint8), depth, cls.astype(np.uint8)


def write_drive(
    folder: Path, drive: str, frames: int, *, dense: bool = True, lidar: bool = False, images: bool = True
) -> None:
    """Write ``folder/<drive>.h5`` with `frames` frames that have what the flags say."""
    recorded = [Frame(number, number / 10) for number in range(frames)]
    for frame in recorded:
        image, depth_m, cls = scene(frame.number)
        frame.image = image if images else None
        frame.depth_m, frame.cls = (depth_m, cls) if dense else (None, None)
        frame.scan = scan(depth_m) if lidar else None
    ingest_drive(
        recorded,
        folder / f"{drive}.h5",
        drive=drive,
        camera=Camera(K, SIZE, T_cam_velo=T_CAM_VELO if lidar else None),
        settings=Reading(image_size=SIZE, cameras=[2], lidar=lidar, on_damaged="fail"),
        truth=("depth", "cls") if dense else (),
        oxts=dict(enumerate(make_rows(frames, vf=8.0))),
    )


def write_perception(folder: Path, ingest: Path, drive: str) -> None:
    """Write ``folder/<drive>.h5`` with the true depth and classes of the frames that have an image."""
    params = {"perception": {"depth_scale": "metric"}}
    with (
        store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw,
        store.DriveWriter(folder / f"{drive}.h5", stage="perception", drive=drive, params=params) as file,
    ):
        file.attrs["camera_height_m"] = CAMERA_HEIGHT_M
        rows = np.flatnonzero(raw["has_image"])
        scenes = [scene(row) for row in rows]
        file.put("frame", raw.frame[rows])
        file.put("time_s", raw.time_s[rows])
        file.put("depth_m", np.array([to_units(depth) for _, depth, _ in scenes], np.uint16).reshape(-1, *SIZE))
        file.put("cls", np.array([cls for *_, cls in scenes], np.uint8).reshape(-1, *SIZE))


def scan(depth_m: np.ndarray) -> np.ndarray:
    """Return velodyne points float32 [N,4] that hit every fourth pixel of each other row."""
    sparse = np.zeros_like(depth_m)
    sparse[::2, ::4] = depth_m[::2, ::4]
    xyz = back_project(sparse, K)[sparse > 0]
    velo = (xyz - T_CAM_VELO[:3, 3]) @ T_CAM_VELO[:3, :3]
    return np.c_[velo, np.full(len(velo), 0.5)].astype(np.float32)
