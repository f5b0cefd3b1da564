"""Write the ingest file, data/ingest/<drive>.h5: everything that later stages need of a recording.

Each row belongs to a frame number. Missing data has the fill value, and ``has_<name>`` is 0.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, Frame, write_camera
from pipeline.camera.classes import VOID
from pipeline.camera.images import nearest, read_classes, read_depth, read_image, resized, to_metres, to_units
from pipeline.kitti import oxts as packets
from pipeline.kitti.raw import KittiDrive, read_scan
from pipeline.settings.ingest import Reading

Files = Mapping[int, Path]
UNITS = {"image": "RGB", "depth": "1/256 m, 0 = none", "cls": f"trainId, {VOID} = void"}
SUMMARY = (
    "{frames} frames, {image} images of camera {camera}, {lidar} scans, {depth} depth and {cls} class maps, {steering} "
    "steering angles; {left_out} images or scans without a frame, {damaged} damaged files left out"
)


def ingest_drive(
    frames: Iterable[Frame],
    path: Path,
    *,
    drive: str,
    camera: Camera | None,
    settings: Reading,
    truth: Sequence[str] = (),
    oxts: Mapping[int, np.ndarray] | None = None,
    steering_rad: Mapping[int, float] | None = None,
    number: int = -1,
) -> Summary:
    """Write the ingest file of a recording and return the number of frames, images, scans, …

    Args:
        frames: in order, with complete images, depth and classes of the camera's size; read once.
        camera: of complete images, which are cropped around the horizon; None: a recording without images and scans.
        truth: datasets of ground truth that the file has, of "depth" and "cls".
        oxts: frame number → packet [30]; if given, of each frame.
        steering_rad: frame number → recorded angle of the front wheels.
        number: of the camera, stored in the file.

    Raises InputError if there are no frames.
    """
    size, recorded = settings.image_size, steering_rad or {}
    crop = camera.crop_to(size) if camera else None
    numbers, times_s, points = list[int](), list[float](), list[int]()
    none: dict[str, np.ndarray] = {"image": np.zeros((*size, 3), np.uint8), "depth": np.zeros(size, np.uint16)}
    none["cls"] = np.full(size, VOID, np.uint8)
    has: dict[str, list[bool]] = {name: [] for name in UNITS}
    with DriveWriter(path, stage="ingest", drive=drive, params={"ingest": settings.model_dump(mode="json")}) as file:
        file.attrs["camera"] = number
        for frame in frames:
            numbers.append(frame.number)
            times_s.append(frame.time_s)
            depth = None if frame.depth_m is None else to_units(frame.depth_m)
            for name, pixels in {"image": frame.image, "depth": depth, "cls": frame.cls}.items():
                has[name].append(pixels is not None)
                if name == "image" or name in truth:
                    resize = resized if name == "image" else nearest
                    row = none[name] if pixels is None or crop is None else resize(crop.pixels(pixels), size)
                    file.append(name, row[None], UNITS[name])
            scan = np.zeros((0, 4), np.float32) if frame.scan is None else frame.scan
            file.append("lidar", scan, "m, m, m, reflectance", "lidar_ptr")
            points.append(len(scan))
        if not numbers:
            raise InputError("recording has no frames", drive)
        file.put("frame", np.array(numbers, np.int32))
        file.put("time_s", np.array(times_s), "s")
        if oxts:
            file.put("oxts", np.array([oxts[number] for number in numbers]), "as KITTI's oxts/dataformat.txt")
        if recorded:
            angles = [recorded.get(number, 0.0) for number in numbers]
            file.put("steering_rad", np.array(angles), "rad, left positive")
            file.put("has_steering", np.array([number in recorded for number in numbers], np.uint8))
        if camera and crop:
            write_camera(file, camera.cropped(crop).scaled(size))
        file.put_pointers("lidar_ptr", points, "rows of lidar")
        has["lidar"] = [count > 0 for count in points]
        for name, present in has.items():
            file.put(f"has_{name}", np.array(present, np.uint8))
    counts = {name: sum(present) for name, present in has.items()}
    steering = sum(number in recorded for number in numbers)
    return {"frames": len(numbers), "oxts": len(numbers) if oxts else 0, "steering": steering, **counts}


def ingest_kitti(path: Path, *, drive: str, folder: Path, settings: Reading) -> Summary:
    """Write the frames of a KITTI drive: those with an oxts packet or, in a drive without oxts, those with an image.

    Raises InputError if packets, times or the calibration are missing; DamagedFile that lists all damaged files.
    """
    files, skip = KittiDrive(folder), settings.on_damaged == "skip"
    number = files.camera_number(settings.cameras)
    camera = None if number is None else files.camera(number)
    scans = files.scans if settings.lidar else {}
    if scans and (camera is None or camera.T_cam_velo is None):
        problem = "drive has scans, but calib_cam_to_cam.txt or calib_velo_to_cam.txt is missing"
        fix = "Extract the date's calibration archive, or set ingest.lidar: false"
        raise InputError(problem, files.calibration, fix)
    damaged, (numbers, times) = list[DamagedFile](), files.timeline(number)

    def read(reader: Callable[..., np.ndarray], paths: Files, frame: int, **options: Any) -> np.ndarray | None:
        """Return the content of a frame's file; None if there is none, or it is damaged."""
        try:
            return reader(paths[frame], **options) if frame in paths else None
        except DamagedFile as error:
            damaged.append(error)
            return None

    oxts = {frame: row for frame in numbers if (row := read(packets.read_row, files.oxts, frame)) is not None}
    if not numbers or (not files.oxts and files.oxts_times.parent.is_dir()) or (skip and files.oxts and not oxts):
        fix = "Extract it. Only if labels come from another labels.source: remove the empty folder"
        raise InputError("drive has no oxts packets", files.oxts_times.parent, fix)
    # Lines of timestamps.txt correspond to existing files, including damaged ones.
    time_s = dict(zip(numbers, packets.read_times(times, numbers).tolist(), strict=True))
    images = {} if number is None else files.images(number)
    truth = {"depth": files.truth_depth, "cls": files.truth_cls} if camera else {}

    def frames() -> Iterator[Frame]:
        for number in oxts or numbers:
            frame = Frame(number, time_s[number], scan=read(read_scan, scans, number))
            if camera:
                frame.image = read(read_image, images, number, size=camera.size)
                depth = read(read_depth, truth["depth"], number, size=camera.size)
                frame.depth_m = None if depth is None else to_metres(depth)
                frame.cls = read(read_classes, truth["cls"], number, size=camera.size)
            yield frame

    summary = ingest_drive(
        frames(),
        path,
        drive=drive,
        camera=camera,
        settings=settings,
        truth=[name for name, paths in truth.items() if paths],
        oxts=oxts,
        steering_rad=packets.read_steering(files.steering) if files.steering else None,
        number=-1 if number is None else number,
    )
    if damaged and not skip:
        faults = "; ".join(f"{error.where}: {error.problem}" for error in damaged)
        fix = "Extract them again, or set ingest.on_damaged: skip to leave them out"
        raise DamagedFile(faults, f"{len(damaged)} damaged files", fix)
    left_out = len({*images, *scans} - {*numbers})
    return summary | {"camera": number, "left_out": left_out, "damaged": len(damaged)}
