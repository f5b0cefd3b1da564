"""A street with a textured road and houses, seen exactly from wherever the camera is, and as files
of the stages.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.geometry import CAMERA_HEIGHT_M, back_project, camera_rays
from pipeline.camera.images import to_units
from pipeline.ingest import write
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.packets import make_packets
from pipeline.ingest.settings import Reading
from pipeline.perception.perception_file import create_perception

SIZE = (32, 64)
K = np.array([[40.0, 0.0, 31.0], [0.0, 40.0, 12.0], [0.0, 0.0, 1.0]])
# velodyne x forward, y left, z up → camera x right, y down, z forward, with a small offset
T_CAM_VELO = np.array([[0.0, -1, 0, 0.0], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])
CAMERA = Camera(K, SIZE)  # of the files: a few kilobytes
# The camera of drives whose motion is measured.
WIDE = Camera(np.array([[180.0, 0.0, 159.5], [0.0, 180.0, 44.0], [0.0, 0.0, 1.0]]), (96, 320))
# Factor by which images are rendered larger than the camera's.
FINER = 2

# The street between two walls with an end, in metres.
HALF_WIDTH_M = 7.0
END_M = 60.0
ROOF_M = 5.0


@cache
def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (256, 256)).astype(np.float32)


def _texture(a: np.ndarray, b: np.ndarray, seed: int) -> np.ndarray:
    """Return brightness at places in metres on a surface: noise at 0.4, 1.6 and 6.4 m."""
    total = np.zeros_like(a)
    for octave, grain_m in enumerate((0.4, 1.6, 6.4)):
        u = np.float32(np.mod(a / grain_m, 250))
        v = np.float32(np.mod(b / grain_m, 250))
        total += cv2.remap(_noise(10 * seed + octave), u, v, cv2.INTER_LINEAR)
    return total / 3


def view(
    T_world_cam: np.ndarray, camera: Camera = WIDE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what is seen from a pose: an image, depth and classes.

    The image is uint8 [H,W,3], depth float32 [H,W] in metres, 0 in the sky, and classes are
    trainIds [H,W]. The world's frame is that of a camera at the beginning of the street, which
    leads along z.
    """
    # Aliases of a coarse image would not move as it does.
    height, width = camera.size
    fine = (height * FINER, width * FINER)
    grey, *_ = _render(T_world_cam, camera.scaled(fine).K, fine)
    grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
    image = np.repeat(grey[..., None], 3, axis=-1)

    _, depth_m, which, sky = _render(T_world_cam, camera.K, camera.size)
    cls = np.where(which == 0, classes.ROAD, classes.BUILDING).astype(np.uint8)
    cls[sky] = classes.SKY
    depth_m[sky] = 0
    return image, depth_m.astype(np.float32), cls


def _render(
    T_world_cam: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, ...]:
    """Return brightness, depth, the number of the plane and whether it is sky, each [H,W]."""
    direction = camera_rays(K, size) @ T_world_cam[:3, :3].T  # of depth 1
    origin = T_world_cam[:3, 3]
    with np.errstate(divide="ignore"):
        planes = [
            (CAMERA_HEIGHT_M - origin[1]) / direction[..., 1],
            (-HALF_WIDTH_M - origin[0]) / direction[..., 0],
            (HALF_WIDTH_M - origin[0]) / direction[..., 0],
            (END_M - origin[2]) / direction[..., 2],
        ]
    depth = np.stack([np.where(plane > 0, plane, np.inf) for plane in planes])
    which = depth.argmin(axis=0)
    depth = depth.min(axis=0)
    place = origin + direction * np.where(np.isfinite(depth), depth, 0)[..., None]
    grey = np.choose(
        which,
        [
            _texture(place[..., 0], place[..., 2], 1),
            _texture(place[..., 1], place[..., 2], 2),
            _texture(place[..., 1], place[..., 2], 3),
            _texture(place[..., 0], place[..., 1], 4),
        ],
    )
    sky = place[..., 1] < -ROOF_M
    return np.where(sky, 230, grey).astype(np.float32), depth, which, sky


def pose(heading_rad: float, x: float, z: float) -> np.ndarray:
    """Return T_world_cam [4,4] of a camera at x and z in metres.

    It looks `heading_rad` to the left of the street.
    """
    cosine = np.cos(heading_rad)
    sine = np.sin(heading_rad)
    return np.array([[cosine, 0, -sine, x], [0, 1, 0, 0], [sine, 0, cosine, z], [0, 0, 0, 1]])


def arc(frames: int, yaw_rate_radps: float, speed_mps: float) -> list[np.ndarray]:
    """Return the poses of a camera on a circle, or a straight line, left +, every 0.1 s."""
    dt_s = 0.1
    poses = []
    heading = -yaw_rate_radps * dt_s * frames / 2
    x = 0.0
    z = 0.0
    for _ in range(frames):
        poses.append(pose(heading, x, z))
        middle = heading + yaw_rate_radps * dt_s / 2
        chord = speed_mps * dt_s * np.sinc(yaw_rate_radps * dt_s / 2 / np.pi)
        x -= chord * np.sin(middle)
        z += chord * np.cos(middle)
        heading += yaw_rate_radps * dt_s
    return poses


def scene(frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return image uint8 [H,W,3] in colour, depth float64 [H,W] and classes uint8 [H,W] of a frame,
    seen by CAMERA.
    """
    image, depth_m, cls = view(pose(0.0, np.sin(frame), 2.0 * (frame % 20)), CAMERA)
    return image // 2 + classes.COLOURS[cls].astype(np.uint8) // 2, depth_m.astype(np.float64), cls


def write_drive(
    folder: Path,
    drive: str,
    frames: int,
    *,
    dense: bool = True,
    lidar: bool = False,
    images: bool = True,
) -> None:
    """Write ``folder/<drive>.h5`` with `frames` frames that have what the flags say."""
    camera = Camera(K, SIZE, T_cam_velo=T_CAM_VELO if lidar else None)
    settings = Reading(image_size=SIZE, cameras=[2], lidar=lidar, on_damaged="fail")
    recorded = [Frame(number, number / 10, *scene(number)) for number in range(frames)]
    for frame in recorded:
        frame.scan = scan(frame.depth_m) if lidar else None
        frame.image = frame.image if images else None
        frame.depth_m, frame.cls = (frame.depth_m, frame.cls) if dense else (None, None)
    values = {"oxts": dict(enumerate(make_packets(frames, vf=8.0)))}
    source = Drive(camera, lambda: iter(recorded), values)
    write.write_drive(folder / f"{drive}.h5", source, drive, "kitti", settings)


def write_perception(folder: Path, ingest: Path, drive: str) -> None:
    """Write ``folder/<drive>.h5`` with the true depth and classes of the frames that have an
    image.
    """
    params = {"perception": {"batch": 4}}
    with (
        open_ingest(ingest / f"{drive}.h5") as raw,
        create_perception(folder / f"{drive}.h5", drive=drive, params=params) as file,
    ):
        rows = np.flatnonzero(raw["has_image"])
        scenes = [scene(row) for row in rows]
        file.put("frame", raw.frame[rows])
        file.put("time_s", raw.time_s[rows])
        file.put(
            "depth_m",
            np.array([to_units(depth) for _, depth, _ in scenes], np.uint16).reshape(-1, *SIZE),
        )
        file.put("cls", np.array([cls for *_, cls in scenes], np.uint8).reshape(-1, *SIZE))


def scan(depth_m: np.ndarray) -> np.ndarray:
    """Return velodyne points float32 [N,4] that hit every fourth pixel of each other row."""
    sparse = np.zeros_like(depth_m)
    sparse[::2, ::4] = depth_m[::2, ::4]
    xyz = back_project(sparse, K)[sparse > 0]
    velo = (xyz - T_CAM_VELO[:3, 3]) @ T_CAM_VELO[:3, :3]
    return np.c_[velo, np.full(len(velo), 0.5)].astype(np.float32)
