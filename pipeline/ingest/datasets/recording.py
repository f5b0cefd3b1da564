"""Read the parts of recordings that ingest.recordings lists: images, and logs of the car."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.resume import content_hash
from pipeline.ingest.drive import Drive
from pipeline.ingest.log import ROUNDING_S, Logs, logged_values
from pipeline.ingest.recording import Recording, open_recording
from pipeline.ingest.settings import FRAMES, VIDEO, Ingest, Part

# File with the log of the steering wheel's angles, in the folder of a recording.
WHEEL = "wheel.csv"
# File with the log of speed and yaw rate.
MOTION = "motion.csv"
# File with the times of the images.
TIMES = "times.txt"
# File with the scan of all images that steer import made. Stage ingest reads it instead of decoding
# all images for each part.
SCAN = "scan.csv"


def fingerprint(name: str, settings: Ingest, root: Path) -> list[Any]:
    """Return the part's settings, which hold the hashes of its files.

    Raises InputError for a file with another hash. A missing file is accepted, as a machine that
    fetches finished drives does not need it.
    """
    part = settings.recordings[name]
    for path, expected in _paths(part, root).items():
        if path.exists() and _hash(path, path.stat().st_mtime_ns) != expected:
            fix = "Repeat steer import"
            raise InputError("is not the file whose hash ingest.recordings has", path, fix)
    return [part.model_dump(mode="json")]


# All parts of a recording have the same files, so hashes are cached. The second argument is the
# time of the last change, so that a changed file is hashed again.
@cache
def _hash(path: Path, _: int) -> str:
    return content_hash(path)


def open_drive(name: str, settings: Ingest, root: Path) -> Drive:
    """Return the part of a recording.

    If the recording has a log of the motion, images without a logged motion are left out.
    """
    part = settings.recordings[name]
    for path in _paths(part, root):
        if not path.exists():
            lost = f"the link's target {path.readlink()}" if path.is_symlink() else "the file"
            fix = "Repeat steer import, or fetch finished drives: dvc repro --pull --allow-missing"
            raise InputError(f"{lost} is missing", path, fix)

    recording = open_part(part, root / part.folder)
    used = usable(recording.times_s, recording.logs, part.start, part.end)
    if not used.any():
        raise InputError(
            "no image is left from start to end, or none with motion", f"ingest.recordings.{name}"
        )
    camera = replace(recording.camera, horizon=part.horizon).at_height(part.camera_height_m)

    # Read the logs, which have the times of the recording, before the times are shifted: the drive
    # begins at 0.
    time_s = recording.times_s[used]
    values = logged_values(recording.logs, np.flatnonzero(used), time_s)
    recording.times_s = recording.times_s - time_s[0]
    return Drive(camera, partial(recording.frames, used), values, recording.notes)


def open_part(part: Part, folder: Path) -> Recording:
    """Open the recording of a part, whose files are in `folder`."""
    files = {name: folder / name for name in part.files}
    logs = {"wheel": files.get(WHEEL), "motion": files.get(MOTION), "times": files.get(TIMES)}
    options = part.model_copy(update=logs)
    images = [path for name, path in files.items() if name.startswith((VIDEO, FRAMES))]
    scanned = None
    if SCAN in files:
        # The parser of pandas may round the last digit of floats, so they are read as text.
        scanned = pd.read_csv(files[SCAN], comment="#", dtype=str).astype(float)
    return open_recording(images, options, scanned=scanned)


def _paths(part: Part, root: Path) -> dict[Path, str]:
    """Return the files of a recording with their hashes, videos in order."""
    return {root / part.folder / name: expected for name, expected in part.files.items()}


def usable(time_s: np.ndarray, logs: Logs, start_s: float, end_s: float | None) -> np.ndarray:
    """Return which images at `time_s` [F] lie in [start, end) and have a logged motion, bool [F].

    Start and end are seconds since the first image. If there is no log of the motion, only the time
    counts.
    """
    # Times have rounding errors. With this addition, an image at the start is in the part, and an
    # image at the end is not.
    elapsed_s = time_s - time_s[0] + ROUNDING_S
    used = elapsed_s > start_s
    if end_s is not None:
        used &= elapsed_s <= end_s
    if "motion" in logs:
        used &= np.isfinite(logs["motion"].at(time_s)[0])
    return used
