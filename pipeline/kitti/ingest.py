"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a recording.

Each row belongs to a frame number. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, Frame, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import nearest, read_classes, read_depth, read_image, resized, to_units
from pipeline.kitti.oxts import read_row, read_steering, read_times
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.settings.ingest import Reading

# Name → unit, value of missing pixels, how pixels are resized.
MAPS: dict[str, tuple[str, np.ndarray, Callable[..., np.ndarray]]] = {
    "image": ("RGB", np.zeros(3, np.uint8), resized),
    "depth": ("1/256 m, 0 = none", np.array(0, np.uint16), nearest),
    "cls": (f"trainId, {VOID} = void", np.array(VOID, np.uint8), nearest),
}
HAS = (*MAPS, "lidar")


class IngestFile(DriveWriter):
    """Write an ingest file: :meth:`add` the frames in order, then :meth:`finish`. A context manager."""

    def __init__(
        self,
        path: Path,
        drive: str,
        camera: Camera | None,
        settings: Reading,
        truth: Sequence[str] = (),
        dataset: str = "recording",
    ):
        """`camera`: of complete images, which are cropped around the horizon; None: no images and scans.

        `truth`: datasets of ground truth that the file has, of "depth" and "cls"; `dataset`: what the drive is of.
        """
        params = {"dataset": dataset, "ingest": settings.model_dump(mode="json")}
        super().__init__(path, stage="ingest", drive=drive, params=params)
        self.attrs["camera"] = -1  # its number in a KITTI drive
        self._camera, self._size, self._maps = camera, settings.image_size, ("image", *truth)
        self._crop = camera.crop_to(self._size) if camera else None
        self._rows = list[tuple[float, ...]]()  # of each frame: number, time, points, and whether it has the HAS

    def add(self, frame: Frame) -> None:
        """Write a frame, whose image, depth and classes have the camera's size or are None."""
        depth = None if frame.depth_m is None else to_units(frame.depth_m)
        maps = {"image": frame.image, "depth": depth, "cls": frame.cls}
        for name in self._maps:
            unit, fill, resize = MAPS[name]
            row, pixels = np.full((*self._size, *fill.shape), fill), maps[name]
            if pixels is not None and self._crop:
                row = resize(self._crop.pixels(pixels), self._size)
            self.append(name, row[None], unit)
        scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
        self.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")
        has = (pixels is not None for pixels in maps.values())
        self._rows.append((frame.number, frame.time_s, len(scan), *has, len(scan) > 0))

    def finish(self, oxts: Mapping[int, np.ndarray] = {}, steering_rad: Mapping[int, float] = {}) -> Summary:
        """Write the datasets with a value per frame, and return the number of frames, images, scans, …

        `oxts`: frame number → packet [30], of each frame if of any; `steering_rad`: → angle of the front wheels. Raises
        InputError if there are no frames.
        """
        if not self._rows:
            raise InputError("recording has no frames", self.attrs["drive"])
        numbers, times_s, points, *has = zip(*self._rows, strict=True)
        self.put("frame", np.array(numbers, np.int32))
        self.put("time_s", np.array(times_s), "s")
        if oxts:
            self.put("oxts", np.array([oxts[number] for number in numbers]), "as KITTI's oxts/dataformat.txt")
        steered = np.isin(numbers, [*steering_rad])
        if steering_rad:
            angles = [steering_rad.get(number, 0.0) for number in numbers]
            self.put("steering_rad", np.array(angles), "rad, left positive")
            self.put("has_steering", steered.astype(np.uint8))
        if self._camera and self._crop:
            write_camera(self, self._camera.cropped(self._crop).scaled(self._size))
        self.put_pointers("lidar_ptr", points, "rows of lidar")
        for name, present in zip(HAS, has, strict=True):
            self.put(f"has_{name}", np.array(present, np.uint8))
        return {"frames": len(numbers), "steering": int(steered.sum()), **dict(zip(HAS, map(sum, has), strict=True))}


def ingest_kitti(path: Path, *, drive: str, folder: Path, settings: Reading) -> Summary:
    """Write the frames of a KITTI drive: those with an oxts packet or, in a drive without oxts, those with an image.

    Raises InputError if packets, times or the calibration are missing; DamagedFile that lists all damaged files.
    """
    files, skip, damaged = KittiDrive(folder), settings.on_damaged == "skip", list[DamagedFile]()
    chosen = files.camera_number(settings.cameras)
    camera, images = (None, {}) if chosen is None else (files.camera(chosen), files.images(chosen))
    depths, classes = (files.truth_depth, files.truth_cls) if camera else ({}, {})
    scans = files.scans if settings.lidar else {}
    if scans and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        fix = "Extract the date's calibration archive, or set ingest.lidar: false"
        raise InputError(problem, files.calibration, fix)
    packets = {number: _read(read_row, packet, damaged) for number, packet in files.oxts.items()}
    oxts = {number: row for number, row in packets.items() if row is not None}
    numbers, times = files.timeline(chosen)
    if not numbers or (not files.oxts and files.oxts_times.parent.is_dir()):
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", files.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    time_s = dict(zip(numbers, read_times(times, numbers).tolist(), strict=True))
    steering_rad = read_steering(files.steering) if files.steering else {}
    truth = [name for name, paths in {"depth": depths, "cls": classes}.items() if paths]
    with IngestFile(path, drive, camera, settings, truth, files.dataset) as file:
        file.attrs["camera"] = -1 if chosen is None else chosen
        size = camera.size if camera else None
        for number in oxts or numbers:
            frame = Frame(number, time_s[number])
            frame.scan = _read(read_scan, scans.get(number), damaged)
            frame.image = _read(read_image, images.get(number), damaged, size=size)
            frame.depth_m = _read(read_depth, depths.get(number), damaged, size=size)
            frame.cls = _read(read_classes, classes.get(number), damaged, size=size)
            file.add(frame)
        if damaged and not (skip and (oxts or not files.oxts)):
            faults = "; ".join(f"{error.where}: {error.problem}" for error in damaged)
            fix = "Extract them again" + ", or set ingest.on_damaged: skip to leave them out" * (not skip)
            where = "damaged files" if oxts or not files.oxts else "damaged files, among them all oxts packets"
            raise DamagedFile(faults, f"{len(damaged)} {where}", fix)
        summary = file.finish(oxts, steering_rad)
        for kind, paths, count in (("images", images, summary["image"]), ("scans", scans, summary["lidar"])):
            lost = [error for error in damaged if Path(error.where) in paths.values()]
            if lost and not count:  # with on_damaged: skip
                raise InputError(f"all {kind} of the drive are damaged: {lost[0].problem}", lost[0].where)
    counts = {
        f"images of camera {chosen}": summary["image"],
        "scans": summary["lidar"],
        "depth maps": summary["depth"],
        "class maps": summary["cls"],
        "steering angles": summary["steering"],
        "images or scans without a frame": len({*images, *scans} - {*numbers}),
        "damaged files left out": len(damaged),
    }
    text = "".join(f", {count} {name}" for name, count in counts.items() if count)
    return summary | {"counts": text, "damaged": len(damaged)}


def _read(
    reader: Callable[..., np.ndarray], path: Path | None, damaged: list[DamagedFile], **options: Any
) -> np.ndarray | None:
    """Return the content of a file; None if there is none, or it is damaged, which is added to `damaged`."""
    try:
        return reader(path, **options) if path else None
    except DamagedFile as error:
        damaged.append(error)
        return None
