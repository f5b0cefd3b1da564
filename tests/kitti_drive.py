"""Write small drives in KITTI raw's layout, seeded noise but complete and consistent, and small
recordings.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from pipeline.ingest.packets import MOTION

DATE = "2011_09_26"
DRIVE = f"{DATE}_drive_0001"
SIZE = (48, 64)
LINES = 30  # of timestamps.txt


def write_drive(
    root: Path,
    drive: str = DRIVE,
    frames: Iterable[int] = range(4),
    *,
    truth: bool = False,
    seed: int = 0,
) -> Path:
    """Write a drive and its date's calibration below `root`; return the drive's folder."""
    folder = root / drive[:10] / f"{drive}_sync"
    rng = np.random.default_rng(seed)
    for frame in frames:
        name = f"{frame:010d}"
        write_png(folder / f"image_02/data/{name}.png", rng.integers(0, 256, (*SIZE, 3), np.uint8))
        if truth:
            write_png(folder / f"truth/depth/{name}.png", rng.integers(0, 20000, SIZE, np.uint16))
            write_png(folder / f"truth/cls/{name}.png", rng.integers(0, 19, SIZE, np.uint8))
        write(folder / f"velodyne_points/data/{name}.bin", scan(rng).tobytes())
        row = rng.normal(0, 0.1, 30)
        row[MOTION["speed_mps"]] = rng.uniform(2, 12)
        row[MOTION["yaw_rate_radps"]] = rng.normal(0, 0.2)
        write(folder / f"oxts/data/{name}.txt", " ".join(f"{x:.12f}" for x in row) + "\n")
    write(
        folder / "oxts/timestamps.txt",
        "".join(f"2011-09-26 13:02:{25 + i / 10:012.9f}\n" for i in range(LINES)),
    )
    write_calibration(folder.parent)
    return folder


def write_calibration(folder: Path) -> None:
    """Write a date's calibration with the rectified entries of cameras 0 and 2."""
    rectified = [f"R_rect_00: {_numbers(_rotation(0.01))}"]
    for camera in (0, 2):
        P = np.array([[50.0, 0, 31.3, 3.1 * camera], [0, 50.0, 22.2, 0.2], [0, 0, 1, 0.003]])
        rectified += [
            f"S_rect_{camera:02d}: {SIZE[1]} {SIZE[0]}",
            f"P_rect_{camera:02d}: {_numbers(P)}",
        ]
    write(
        folder / "calib_cam_to_cam.txt",
        "calib_time: 09-Jan-2012 13:57:47\n" + "\n".join(rectified) + "\n",
    )
    R = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]) @ _rotation(0.02)
    T = "T: -0.004 -0.076 -0.272"
    write(
        folder / "calib_velo_to_cam.txt",
        f"calib_time: 15-Mar-2012 11:37:16\nR: {_numbers(R)}\n{T}\n",
    )


def scan(rng: np.random.Generator, points: int = 200) -> np.ndarray:
    """Return float32 [P,4] from the top laser to the bottom one."""
    elevation = np.deg2rad(np.linspace(2.0, -24.8, points))
    azimuth = rng.uniform(-np.pi, np.pi, points)
    ray = np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        -1,
    )
    distance = rng.uniform(4, 30, (points, 1))
    return np.hstack([ray * distance, rng.uniform(0, 0.99, (points, 1))]).astype(np.float32)


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write grey or RGB pixels."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def write(path: Path, content: str | bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def write_params(
    path: Path,
    train: list[str],
    test: list[str],
    labels: dict[str, Any] | None = None,
    **ingest: Any,
) -> Path:
    """Write a params file with the sections that ingest and labels read."""
    reading = {
        "source": "kitti",
        "image_size": [36, 48],
        "cameras": [2, 0],
        "lidar": True,
        "on_damaged": "fail",
    }
    drives = {"train": train, "val": [], "test": test}
    car = {"wheelbase_m": 2.7, "min_speed_mps": 1.0}
    path.write_text(
        yaml.safe_dump(
            {"ingest": reading | {"drives": drives} | ingest, "labels": car | (labels or {})}
        )
    )
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Return relative path → contents of all files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{x:.9e}" for x in values.ravel())


def _rotation(angle: float) -> np.ndarray:
    c = np.cos(angle)
    s = np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return about_z @ about_x


def pictures(count: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return uint8 [count,H,W,3]: smooth, so that video codecs change them little; each has its own
    grey.
    """
    v, u = np.mgrid[: size[0], : size[1]]
    ramp = np.stack([u * 60 // size[1], v * 60 // size[0], 0 * u], axis=-1)
    return np.stack([ramp + 40 + 150 * number // count for number in range(count)]).astype(np.uint8)


def write_video(
    path: Path, images: Sequence[np.ndarray] | np.ndarray, fps: float = 10.0, codec: str = "mp4v"
) -> Path:
    """Write RGB images as a video, by default MPEG-4."""
    height, width = images[0].shape[:2]
    file = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*codec), fps, (width, height)
    )  # type: ignore[attr-defined]
    assert file.isOpened()
    for image in images:
        file.write(np.ascontiguousarray(image[..., ::-1]))
    file.release()
    return path


def write_folder(folder: Path, images: Sequence[np.ndarray] | np.ndarray) -> Path:
    for number, image in enumerate(images):
        write_png(folder / f"{number:06d}.png", image)
    return folder
