"""Cache depth, classes and motion in the output folder of `steer measure`, for `steer predict`."""

import json
from pathlib import Path
from typing import Any

from pipeline.jobs.keys import LOADED, stage_key
from pipeline.jobs.outputs import link_or_copy

from pipeline.base.errors import InputError
from pipeline.base.store import write_json
from pipeline.base.summary import Summary
from pipeline.encoder.encoder_file import FILE
from pipeline.perception.settings import Perception

# Folder of the cache in an output folder of `steer measure`.
FOLDER = "measurement"
# Names of the files in it, see steer/chain.py. The images are in the drive.
FILES = ("perception.h5", "motion.h5")
# Name of the file with the cache key, the summary of the motion and the folder of the drive.
RECORD = "measurement.json"
# Code that has no part in depth, classes and motion.
_OTHER_CODE = (
    "stages/",
    "models/steering/",
    "pipeline/jobs/",
    "pipeline/train/",
    "pipeline/report/",
)


def measurement_key(ingest: Path, perception: Perception, encoder: Path) -> str:
    """Return the cache key of depth, classes and motion of the images in a file of stage ingest.

    `encoder` is the folder of an encoder.
    """
    code = {name: value for name, value in LOADED.items() if not name.startswith(_OTHER_CODE)}
    settings = {"code": code, "perception": perception.model_dump()}
    return stage_key("", settings, [ingest, encoder / FILE])


def save_measurement(out: Path, work: Path, key: str, facts: Summary, drive: Path) -> None:
    """Save the files that :func:`steer.chain.run_chain` wrote to `work` in the output folder `out`.

    `drive` is the folder of the drive, with its absolute path.
    """
    folder = out / FOLDER
    folder.mkdir()
    for name in FILES:
        link_or_copy(work / name, folder / name)
    # The output folder can be moved with the drive in it.
    if drive.is_relative_to(out.absolute()):
        drive = drive.relative_to(out.absolute())
    write_json(folder / RECORD, {"key": key, "facts": facts, "drive": str(drive)})


def reuse_measurement(out: Path, work: Path, key: str) -> Summary | None:
    """Link the files in the cache of `out` to `work`, and return the summary of the motion.

    Returns None if there is no cache, or it has another key.
    """
    record = _read_record(out)
    if record is None or record["key"] != key:
        return None
    for name in FILES:
        link_or_copy(out / FOLDER / name, work / name)
    return record["facts"]


def find_drive(path: Path) -> Path:
    """Return the drive of an output folder of `steer measure`, or `path` if it is another path.

    Raises InputError if the drive has been moved.
    """
    record = _read_record(path)
    if record is None:
        return path
    drive = path / record["drive"]
    if not drive.is_dir():
        raise InputError(f"its drive is missing: {drive}", path, "Pass the drive itself")
    return drive


def _read_record(out: Path) -> dict[str, Any] | None:
    """Return the record of a cache; None if `out` has no complete one."""
    folder = out / FOLDER
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    names = {"key", "facts", "drive"}
    is_complete = all((folder / name).is_file() for name in FILES)
    if not is_complete or not isinstance(record, dict) or not names <= record.keys():
        return None
    return record
