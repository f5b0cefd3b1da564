"""Read Udacity's Challenge 2: videos of the centre camera, and steering wheel angles from CAN.

Drive NAME is the video data/raw/udacity/NAME.mp4. NAME.csv beside it has the columns time_s and
wheel_rad (left positive), and a row for each frame of the video.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.ingest.columns import LIMIT_RAD, check_increase, read_columns, refuse
from pipeline.ingest.drive import Drive, stamps
from pipeline.ingest.recording import open_recording
from pipeline.ingest.settings import Ingest, RecordingOptions

# Intrinsics FX,FY,CX,CY in pixels. They are those of the rig's right-hand camera, whose images have
# the same size: sensor_info/camera_calibration/right_camera/ost.yaml of the challenge.
K = "2152,2166,268,303"
# Distortion of this camera, from the same file.
DISTORTION = "-0.042,-0.89,0,0"
# Image row of the horizon, as steer import estimates it.
HORIZON = 215.24
# Height in metres of the camera over the road. Lanes, which are 3.66 m wide, are 2.5 camera heights
# wide in the images.
CAMERA_HEIGHT_M = 1.48
# Ratio of the steering wheel's angle to the front wheels' of a Lincoln MKZ.
STEERING_RATIO = 14.8


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return the names, sizes and times of the two files."""
    return stamps(_files(name, root), root)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return a drive, with steering angles and without oxts."""
    return read_drive(*_files(name, root))


def read_drive(video: Path, log: Path) -> Drive:
    """Return a drive. Raises InputError if the log does not belong to the video."""
    recording = open_recording([video], RecordingOptions(K=K, distortion=DISTORTION))
    camera = replace(recording.camera, horizon=HORIZON).at_height(CAMERA_HEIGHT_M)
    limits = {"time_s": np.inf, "wheel_rad": LIMIT_RAD * STEERING_RATIO}
    table, faults = read_columns(log, limits, "Expected CSV: time_s, wheel_rad")
    faults += check_increase(table["time_s"], 1e-5)
    if len(table) != len(recording.times_s):
        faults.append(f"has {len(table)} rows, the video {len(recording.times_s)} frames")
    refuse(faults, log, "Take both files of one drive")
    recording.times_s = table["time_s"].to_numpy()
    wheel_rad = table["wheel_rad"].reset_index(drop=True)
    angles = (wheel_rad / STEERING_RATIO).dropna().to_dict()
    return Drive(camera, recording.frames, {"steering_rad": angles}, recording.notes)


def _files(name: str, root: Path) -> list[Path]:
    files = [root / f"udacity/{name}{suffix}" for suffix in (".mp4", ".csv")]
    for path in files:
        if not path.is_file():
            raise InputError(
                "file is missing", path, "Copy it there, or take the drive out of ingest.drives"
            )
    return files
