"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a drive of any dataset.

Each row belongs to a frame number. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, Frame, camera_height, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import nearest, resized, to_units
from pipeline.datasets.core.drive import Drive
from pipeline.settings.ingest import Reading

# Name → unit, value of missing pixels, how pixels are resized.
MAPS: dict[str, tuple[str, np.ndarray, Callable[..., np.ndarray]]] = {
    "image": ("RGB", np.zeros(3, np.uint8), resized),
    "depth": ("1/256 m, 0 = none", np.array(0, np.uint16), nearest),
    "cls": (f"trainId, {VOID} = void", np.array(VOID, np.uint8), nearest),
}
HAS = (*MAPS, "lidar")
# Of the values of a frame: unit, and the value of a frame without one. Of oxts, each frame has a packet.
VALUES: dict[str, tuple[str, float]] = {
    "oxts": ("as KITTI's oxts/dataformat.txt", np.nan),
    "steering_rad": ("rad, left positive", 0.0),
    "speed_mps": ("m/s, forward positive", np.nan),
    "yaw_rate_radps": ("rad/s, left positive", np.nan),
}
COUNTS = {
    "image": "images",
    "lidar": "scans",
    "depth": "depth maps",
    "cls": "class maps",
    "steering": "steering angles",
}


def write_drive(
    path: Path, drive: Drive, name: str, dataset: str, settings: Reading, advance: Callable[[int], object] | None = None
) -> Summary:
    """Write a drive of `dataset`; `advance` is called with the number of frames that are done since the last call.

    Returns the counts of frames, images, scans, …, and ``counts``, a text. Raises InputError if there are no frames.
    """
    with IngestFile(path, name, drive.camera, settings, drive.dataset or dataset) as file:
        for frame in drive.frames():
            file.add(frame)
            if advance:
                advance(1)
        summary = file.finish(drive.values)
    texts = [*(f"{summary[key]} {text}" for key, text in COUNTS.items() if summary[key]), *drive.notes]
    return summary | {"counts": "".join(f", {text}" for text in texts)}


class IngestFile(DriveWriter):
    """Write an ingest file: :meth:`add` the frames in order, then :meth:`finish`. A context manager."""

    def __init__(self, path: Path, drive: str, camera: Camera | None, settings: Reading, dataset: str = "recording"):
        """`camera`: of complete images, which are cropped around the horizon; None: no images and scans."""
        params: dict[str, Any] = {"dataset": dataset, "ingest": settings.model_dump(mode="json")}
        if camera and camera.height_known and camera.height_m != camera_height(camera.T_cam_velo):
            params["camera_height_m"] = camera.height_m
        super().__init__(path, stage="ingest", drive=drive, params=params)
        self._camera, self._size, self._maps = camera, settings.image_size, ["image"]
        self._crop = camera.crop_to(self._size) if camera else None
        self._rows = list[tuple[float, ...]]()  # of each frame: number, time, points, and whether it has the HAS

    def add(self, frame: Frame) -> None:
        """Write a frame, whose image, depth and classes have the camera's size or are None."""
        depth = None if frame.depth_m is None else to_units(frame.depth_m)
        maps = {"image": frame.image, "depth": depth, "cls": frame.cls}
        for name, pixels in maps.items():
            unit, fill, resize = MAPS[name]
            empty = np.broadcast_to(fill, (*self._size, *fill.shape))
            if pixels is not None and name not in self._maps:  # the first depth or classes
                self._maps.append(name)
                for _ in self._rows:
                    self.append(name, empty[None], unit)
            if name in self._maps:
                row = resize(self._crop.pixels(pixels), self._size) if pixels is not None and self._crop else empty
                self.append(name, row[None], unit)
        scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
        self.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")
        has = (pixels is not None for pixels in maps.values())
        self._rows.append((frame.number, frame.time_s, len(scan), *has, len(scan) > 0))

    def finish(self, values: Mapping[str, Mapping[int, Any]] = {}) -> Summary:
        """Write the datasets with a value per frame, and return the number of frames, images, scans, …

        `values`: see :class:`Drive`. Raises InputError if there are no frames.
        """
        if not self._rows:
            raise InputError("drive has no frames", self.attrs["drive"])
        numbers, times_s, points, *has = zip(*self._rows, strict=True)
        self.put("frame", np.array(numbers, np.int32))
        self.put("time_s", np.array(times_s), "s")
        steered = np.isin(numbers, [*values.get("steering_rad", ())])
        for name, (unit, unknown) in VALUES.items():
            if of_frame := values.get(name):
                self.put(name, np.array([of_frame.get(number, unknown) for number in numbers]), unit)
                if name == "steering_rad":
                    self.put("has_steering", steered.astype(np.uint8))
        if self._camera and self._crop:
            write_camera(self, self._camera.cropped(self._crop).scaled(self._size))
        self.put_pointers("lidar_ptr", points, "rows of lidar")
        for name, present in zip(HAS, has, strict=True):
            self.put(f"has_{name}", np.array(present, np.uint8))
        return {"frames": len(numbers), "steering": int(steered.sum()), **dict(zip(HAS, map(sum, has), strict=True))}
