"""The interface of a dataset's file, ``pipeline/ingest/datasets/NAME.py``: two functions.

- ``fingerprint(name, settings, root)`` returns a list of JSON-able facts that change with the
  drive's files, for instance :func:`list_file_facts`. Each run calls it for each drive, so it
  should decode no images.
- ``open_drive(name, settings, root)`` returns a :class:`Drive`.

`settings` is section ``ingest``. `root` is the folder data/raw, or data/sample for the rendered
sample. pipeline/ingest/validate.py checks what the functions return.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.camera import Camera, Frame
from pipeline.ingest.columns import LIMIT_MPS, LIMIT_RAD, LIMIT_RADPS

# Recorded value of each frame → its largest plausible magnitude, in the unit that
# pipeline/ingest/ingest_file.py has for it. In a drive with oxts, limits are those of the motion in
# the packets.
LIMITS = {
    "oxts": np.inf,
    "steering_rad": LIMIT_RAD,
    "speed_mps": LIMIT_MPS,
    "left_mps": LIMIT_MPS,
    "yaw_rate_radps": LIMIT_RADPS,
}


@dataclass
class Drive:
    """One drive of a dataset."""

    # The camera of the complete, rectified images, also if the drive has scans alone.
    camera: Camera
    # Frames in ascending numbers and times in seconds, which may begin anywhere. Images, depth and
    # classes have the camera's size. If a field of a frame is a function that reads it, the setting
    # on_damaged applies to damaged files.
    frames: Callable[[], Iterator[Frame]]
    # Recorded values: name → frame number → value, which is NaN or None if it is unknown. A drive
    # may have steering_rad, and either speed_mps and yaw_rate_radps or oxts packets [30]. Units
    # are those of pipeline/ingest/ingest_file.py.
    values: Mapping[str, Mapping[int, Any]] = field(default_factory=dict)
    # Notes for the user. They are complete after write_drive.
    notes: list[str] = field(default_factory=list)
    # Name of the dataset, if it differs from the name of the dataset's file.
    dataset: str = ""
    # Number of video files or folders of images from which it was imported.
    recordings: int = 1
    # Damaged files of the values, which are left out.
    damaged: list[DamagedFile] = field(default_factory=list)


def load_dataset(name: str) -> ModuleType:
    """Return the module of a dataset's file; section ingest has checked that it exists.

    Raises InputError if it lacks a function of the interface.
    """
    module = importlib.import_module(f"pipeline.ingest.datasets.{name}")
    for function in ("fingerprint", "open_drive"):
        if not callable(getattr(module, function, None)):
            path = f"pipeline/ingest/datasets/{name}.py"
            raise InputError(f"has no function {function}", path, "Add it: see folders.py")
    return module


def list_file_facts(paths: Iterable[Path], folder: Path) -> list[Any]:
    """Return the name relative to `folder`, the size and the times of each file.

    Hashing KITTI's 175 GB would take longer than ingesting them. The change time detects a file
    that was extracted again: unzip restores the modification time.
    """
    facts = []
    for path in paths:
        stat = path.stat()
        name = str(path.relative_to(folder))
        facts.append([name, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns])
    return facts
