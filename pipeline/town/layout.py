"""Write a drive in KITTI raw's layout.

Ground truth lies beside it: truth/depth (16-bit PNG, metres x 256, 0: none) and truth/cls (trainIds).
"""

from pathlib import Path

import cv2
import numpy as np

from pipeline.camera.pixels import write_png
from pipeline.town.oxts import Recording

# Level 1 and one filter per file: half the time of writing and two thirds of reading for 13 kB more of a frame's 130.
_LEVEL = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER)


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
        none, up = cv2.IMWRITE_PNG_FILTER_NONE, cv2.IMWRITE_PNG_FILTER_UP
        for kind, pixels, png_filter in (("image", rgb, none), ("depth", depth, up), ("cls", cls, none)):
            write_png(self._folders[kind] / f"{frame:010d}.png", pixels, *_LEVEL, png_filter)
        (self._folders["scan"] / f"{frame:010d}.bin").write_bytes(scan.astype("<f4").tobytes())

    def put_recording(self, recording: Recording) -> None:
        """Write the oxts files, and timestamps.txt of all sensors, which are synchronised."""
        for frame, packet in recording.packets.items():
            (self._folders["oxts"] / f"{frame:010d}.txt").write_bytes(packet)
        for sensor in ("image_02", "velodyne_points", "oxts"):
            (self._root / sensor / "timestamps.txt").write_bytes(recording.timestamps)
