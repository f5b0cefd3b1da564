"""A drive's folder in KITTI raw's layout, of images and oxts packets."""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import date
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from pipeline.base.errors import InputError
from pipeline.base.params import Drive
from pipeline.camera.calib_file import write_entries
from pipeline.camera.images import Size
from pipeline.kitti.calibration import Camera, read_camera
from pipeline.town.recording import make_recording

CAMERA = 2  # the left colour camera, the first that stage ingest looks for
_FILE = "calib_cam_to_cam.txt"
_NOON_S = 12 * 3600.0  # the first image's time of day, which nothing depends on
_SAME_PX = 1e-6  # what a calibration file's digits leave open


def drive_folder(out: Path, drive: str) -> Path:
    """Return where a drive lies below `out`. Raises InputError if `drive` is not named as KITTI's are."""
    try:
        TypeAdapter(Drive).validate_python(drive)
        date.fromisoformat(drive[:10].replace("_", "-"))
    except (ValidationError, ValueError):
        raise InputError(
            f"--drive {drive} is not a drive's name: a date and four digits, as 2027_03_31_drive_0001"
        ) from None
    return out / drive[:10] / f"{drive}_sync"


def write_images(folder: Path, images: Iterable[tuple[int, np.ndarray]], threads: int) -> None:
    """Write numbered RGB images [H,W,3] as PNG files of camera 2, encoded by so many threads.

    No more images are in memory than twice the threads.
    """
    data = folder / f"image_{CAMERA:02d}" / "data"
    data.mkdir(parents=True)
    pending: deque[Future[None]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for number, image in images:
            if len(pending) == 2 * threads:
                pending.popleft().result()
            pending.append(pool.submit(_write_png, data / f"{number:010d}.png", image))
        for one in pending:
            one.result()


def _write_png(path: Path, image: np.ndarray) -> None:
    import cv2

    content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
    path.write_bytes(content.tobytes())


def write_packets(folder: Path, rows: np.ndarray, kept: np.ndarray, time_s: np.ndarray) -> None:
    """Write the packets `rows` [K,30] of the images that are `kept`, bool [F], and the times [F] in seconds of all."""
    recording = make_recording(rows, time_s - time_s[0], folder.name[:10], _NOON_S)
    data = folder / "oxts" / "data"
    data.mkdir(parents=True)
    for number, packet in zip(np.flatnonzero(kept), recording.packets.values(), strict=True):
        (data / f"{number:010d}.txt").write_bytes(packet)
    for sensor in ("oxts", f"image_{CAMERA:02d}"):
        (folder / sensor / "timestamps.txt").write_bytes(recording.timestamps)


def check_calibration(folder: Path, size: Size, K: np.ndarray, force: bool) -> None:
    """Raise InputError if the date of the drive at `folder` has the calibration of another camera.

    With `force`, only if other drives share it.
    """
    camera = _calibrated(folder.parent)
    if camera is None or _is(camera, size, K):
        return
    others = sorted(other.name for other in folder.parent.glob("*_sync") if other != folder)
    if others or not force:
        hint = f"{others[0]} needs it" if others else "--force replaces it"
        raise InputError(
            f"{folder.parent} has the calibration of another camera ({_told(camera.size, camera.K)}) than this one "
            f"({_told(size, K)}): give --drive another date, for drives of one date share it ({hint})"
        )


def write_calibration(folder: Path, size: Size, K: np.ndarray) -> None:
    """Write calib_cam_to_cam.txt of the date of the drive at `folder`, unless one that says the same is there."""
    camera = _calibrated(folder.parent)
    if camera is None or not _is(camera, size, K):
        entries = {
            f"S_rect_{CAMERA:02d}": np.array(size[::-1], float),
            "R_rect_00": np.eye(3),
            f"P_rect_{CAMERA:02d}": np.column_stack([K, np.zeros(3)]),
        }
        write_entries(folder.parent / _FILE, entries)


def _calibrated(date_folder: Path) -> Camera | None:
    return read_camera(date_folder, CAMERA) if (date_folder / _FILE).is_file() else None


def _is(camera: Camera, size: Size, K: np.ndarray) -> bool:
    return camera.size == size and np.allclose(camera.K, K, rtol=0, atol=_SAME_PX)


def _told(size: Size, K: np.ndarray) -> str:
    return f"{size[1]} x {size[0]}, focal length {K[0, 0]:.2f}, centre {K[0, 2]:.1f}, {K[1, 2]:.1f}"
