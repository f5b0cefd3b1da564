"""KITTI raw's file layout, written.

Truth lies beside it: truth/depth (16-bit PNG, metres x 256, 0: none) and truth/cls (trainIds).
"""

from pathlib import Path

import numpy as np

from pipeline.camera.images import to_metres
from pipeline.camera.png import read_png
from pipeline.town.recording import Recording

_PNG_LEVEL = 1  # a higher one saves little and costs more than rendering


class DriveFolder:
    """One drive's folder, filled frame by frame."""

    def __init__(self, folder: Path) -> None:
        self._folders = {
            "image": folder / "image_02" / "data",
            "scan": folder / "velodyne_points" / "data",
            "oxts": folder / "oxts" / "data",
            "depth": folder / "truth" / "depth",
            "cls": folder / "truth" / "cls",
        }
        for path in self._folders.values():
            path.mkdir(parents=True)
        self._root = folder

    def put(self, frame: int, rgb: np.ndarray, depth: np.ndarray, cls: np.ndarray, scan: np.ndarray) -> None:
        """Write a frame: RGB uint8 [H,W,3], depth uint16 [H,W], classes uint8 [H,W], scan float32 [P,4]."""
        import cv2

        name = f"{frame:010d}"
        for kind, image in (("image", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)), ("depth", depth), ("cls", cls)):
            _write_png(self._folders[kind] / f"{name}.png", image)
        (self._folders["scan"] / f"{name}.bin").write_bytes(scan.astype("<f4").tobytes())

    def put_recording(self, recording: Recording) -> None:
        """Write the oxts files, and timestamps.txt of all sensors, which fire together."""
        for frame, packet in recording.packets.items():
            (self._folders["oxts"] / f"{frame:010d}.txt").write_bytes(packet)
        for sensor in ("image_02", "velodyne_points", "oxts"):
            (self._root / sensor / "timestamps.txt").write_bytes(recording.timestamps)


def _write_png(path: Path, image: np.ndarray) -> None:
    import cv2

    # One filter instead of the best of five in each row: half the time of writing, two thirds of that of reading, and
    # of a frame's 130 kB 13 more.
    smooth = image.dtype == np.uint16
    kind = cv2.IMWRITE_PNG_FILTER_UP if smooth else cv2.IMWRITE_PNG_FILTER_NONE
    ok, content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL, cv2.IMWRITE_PNG_FILTER, kind])
    if not ok:
        raise OSError(f"{path}: this image cannot be written as PNG")
    path.write_bytes(content.tobytes())


def read_views(folders: list[Path], count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return picture (RGB), depth in metres and classes of `count` frames, spread over drives and their frames."""
    views = []
    for i in range(count):
        folder = folders[i * len(folders) // count]
        frames = sorted((folder / "truth" / "cls").iterdir())
        name = frames[(2 * i + 1) * len(frames) // (2 * count)].name
        rgb, depth = read_png(folder / "image_02" / "data" / name), read_png(folder / "truth" / "depth" / name)
        views.append((rgb, to_metres(depth), read_png(folder / "truth" / "cls" / name)))
    return views
