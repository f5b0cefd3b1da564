"""Write and read the camera of a drive in its ingest file."""

import numpy as np

from pipeline.base.store import DriveReader, DriveWriter
from pipeline.camera.camera import Camera, camera_height
from pipeline.camera.images import Crop
from pipeline.ingest.ingest_file import UNITS


def write_camera(file: DriveWriter, camera: Camera) -> None:
    """Write a camera's intrinsics to an ingest file, and crop and T_cam_velo if it has them."""
    file.put("K", camera.K, UNITS["K"])
    if camera.crop:
        ranges = zip((camera.crop.rows, camera.crop.columns), camera.crop.image_size, strict=True)
        crop = [[used.start, used.stop, length] for used, length in ranges]
        file.put("crop", np.array(crop, np.int32), UNITS["crop"])
    if camera.T_cam_velo is not None:
        file.put("T_cam_velo", camera.T_cam_velo, UNITS["T_cam_velo"])


def read_camera(file: DriveReader) -> Camera:
    """Return the camera of an ingest file."""
    height, width = file.datasets["image"].shape[1:3]
    T_cam_velo = None
    if "T_cam_velo" in file:
        T_cam_velo = file["T_cam_velo"]
    crop = None
    if "crop" in file:
        (top, bottom, full_height), (left, right, full_width) = file["crop"].tolist()
        crop = Crop(slice(top, bottom), slice(left, right), (full_height, full_width))
    camera = Camera(file["K"], (height, width), T_cam_velo=T_cam_velo, crop=crop)
    return camera.at_height(file.params.get("camera_height_m") or camera_height(T_cam_velo))
