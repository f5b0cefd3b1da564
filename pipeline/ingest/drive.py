"""The interface of a dataset's file, ``pipeline/ingest/datasets/NAME.py``: two functions.

- ``fingerprint(name, settings, root)``: JSON-able facts that change with the drive's files, for
  instance :func:`stamps`; drives with more of them are read first. Each run calls it for each
  drive, so it decodes no images.
- ``open_drive(name, settings, root)``: a :class:`Drive`.

`settings` is section ``ingest``, `root` the folder data/raw; of the rendered sample data/sample.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from pipeline.camera.camera import Camera, Frame


@dataclass
class Drive:
    """One drive of a dataset."""

    # The camera of complete, rectified images; None: no images and no scans.
    camera: Camera | None
    # Frames in ascending numbers. Images, depth and classes have the camera's size.
    frames: Callable[[], Iterator[Frame]]
    # Name → frame number → value: steering_rad; speed_mps and yaw_rate_radps, or oxts [30]; see
    # ingest_file.VALUES.
    values: Mapping[str, Mapping[int, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # for the user; complete after the last frame
    dataset: str = ""  # if it is another than the file's name


def load(name: str) -> ModuleType:
    """Return the module of a dataset's file; section ingest has checked that it exists."""
    return importlib.import_module(f"pipeline.ingest.datasets.{name}")


def stamps(paths: Iterable[Path], folder: Path) -> list[Any]:
    """Return names below `folder`, sizes and times of files.

    Hashing KITTI's 175 GB would take longer than ingesting them. The change time detects a file
    that was extracted again: unzip restores the modification time.
    """
    facts = []
    for path in paths:
        stat = path.stat()
        name = str(path.relative_to(folder))
        facts.append([name, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns])
    return facts
