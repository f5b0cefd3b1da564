"""Ingest a KITTI drive: its frames by number, with what each of them has."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.runner import Summary
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import read_classes, read_depth, read_image, to_metres
from pipeline.kitti import oxts, steering_file
from pipeline.kitti.ingest_file import ingest_drive
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.settings.ingest import Reading

describe = (
    "{frames} frames, {image} images of camera {camera}, {lidar} scans, {depth} depth and {cls} class maps, {steering} "
    "steering angles; {left_out} images or scans without a frame, {faults} damaged files left out"
).format_map


def ingest_kitti(path: Path, *, drive: str, folder: Path, settings: Reading) -> Summary:
    """Write the frames of a drive: those with an oxts packet or, in a drive without oxts, those with an image.

    Raises InputError if packets, times or the calibration are missing; DamagedFile that lists all damaged files.
    """
    files = KittiDrive(folder)
    number = files.camera_number(settings.cameras)
    camera = None if number is None else files.camera(number)
    scans = files.scans if settings.lidar else {}
    if scans and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        fix = "Extract the date's calibration archive, or set ingest.lidar: false"
        raise InputError(problem, files.calibration, fix)
    reader = _Reader(tolerant=settings.on_damaged == "skip")
    numbers, times = files.timeline(number)
    rows = {frame: reader.read("oxts", oxts.read_row, files.oxts, frame) for frame in numbers}
    packets = {frame: row for frame, row in rows.items() if row is not None}
    if not packets and (files.oxts or not numbers or files.oxts_times.parent.is_dir()):
        reader.raise_damaged()
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", files.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    time_s = dict(zip(numbers, oxts.read_times(times, numbers).tolist(), strict=True))
    images = {} if number is None else files.images(number)
    truth = {"depth": files.truth_depth, "cls": files.truth_cls}
    if settings.on_damaged == "skip" and packets:
        time_s = {frame: time_s[frame] for frame in packets}
    summary = ingest_drive(
        _frames(time_s, camera, images, truth, scans, reader),
        path,
        drive=drive,
        camera=camera,
        settings=settings,
        truth=[name for name in truth if camera and truth[name]],
        oxts=packets,
        steering_rad=steering_file.read(files.steering) if files.steering else None,
        attributes={"camera": -1 if number is None else number},
    )
    without = {*images, *scans} - {*numbers}
    damaged = {kind: len(errors) for kind, errors in reader.damaged.items()}
    faults = {"left_out": len(without), "damaged": damaged, "faults": sum(damaged.values())}
    return summary | {"camera": number, **faults}


def _frames(
    time_s: Mapping[int, float],
    camera: Camera | None,
    images: Mapping[int, Path],
    truth: Mapping[str, Mapping[int, Path]],
    scans: Mapping[int, Path],
    reader: "_Reader",
) -> Iterator[Frame]:
    """Yield the frames of `time_s`, number → seconds. Raises DamagedFile at the end."""
    for number, seconds in time_s.items():
        frame = Frame(number, seconds, scan=reader.read("lidar", read_scan, scans, number))
        if camera:
            size = camera.size
            frame.image = reader.read("image", partial(read_image, size=size), images, number)
            depth = reader.read("depth", partial(read_depth, size=size), truth["depth"], number)
            frame.depth_m = None if depth is None else to_metres(depth)
            frame.cls = reader.read("cls", partial(read_classes, size=size), truth["cls"], number)
        yield frame
    reader.raise_damaged()


class _Reader:
    """Read files of single frames, and collect the damaged ones by kind; these count as missing if `tolerant`."""

    def __init__(self, tolerant: bool) -> None:
        self._tolerant = tolerant
        self.damaged: dict[str, list[DamagedFile]] = {}

    def read(
        self, kind: str, read: Callable[[Path], np.ndarray], files: Mapping[int, Path], number: int
    ) -> np.ndarray | None:
        """Return the content of a frame's file; None if there is none or it is damaged."""
        try:
            return read(files[number]) if number in files else None
        except DamagedFile as error:
            self.damaged.setdefault(kind, []).append(error)
            return None

    def raise_damaged(self) -> None:
        """Raise DamagedFile that lists all damaged files, unless they are tolerated."""
        errors = [error for errors in self.damaged.values() for error in errors]
        if errors and not self._tolerant:
            faults = "; ".join(f"{error.where}: {error.problem}" for error in errors)
            fix = "Extract them again, or set ingest.on_damaged: skip to leave them out"
            raise DamagedFile(faults, f"{len(errors)} damaged files", fix)
