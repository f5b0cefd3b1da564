"""Keep what `steer measure` measured in its output folder, so that `steer predict` can use it."""

import json
from pathlib import Path

from pipeline.jobs.keys import LOADED, stage_key
from pipeline.jobs.outputs import link_or_copy

from pipeline.base.store import write_json
from pipeline.base.summary import Summary
from pipeline.encoder.encoder_file import FILE
from pipeline.perception.settings import Perception

# Folder of the kept files in an output folder of `steer measure`.
FOLDER = "measured"
# Names of the kept files, see steer/chain.py. The images are in the drive.
KEPT = ("perception.h5", "motion.h5")
# Name of the file with the key of the kept files, the summary of the motion and the source.
MADE = "made.json"
# Code that has no part in depth, classes and motion.
_OTHER_CODE = (
    "stages/",
    "models/steering/",
    "pipeline/jobs/",
    "pipeline/train/",
    "pipeline/report/",
)


def measured_key(ingest: Path, perception: Perception, encoder: Path) -> str:
    """Return the cache key of depth, classes and motion of the images in a file of stage ingest.

    `encoder` is the folder of an encoder.
    """
    code = {name: value for name, value in LOADED.items() if not name.startswith(_OTHER_CODE)}
    settings = {"code": code, "perception": perception.model_dump()}
    return stage_key("", settings, [ingest, encoder / FILE])


def keep_measured(out: Path, work: Path, key: str, facts: Summary, drive: Path) -> None:
    """Keep the files of :func:`steer.chain.run_chain` in `work` for later predictions.

    `drive` is the folder of the drive, with its absolute path.
    """
    folder = out / FOLDER
    folder.mkdir()
    for name in KEPT:
        link_or_copy(work / name, folder / name)
    # The output folder can be moved with the drive in it.
    if drive.is_relative_to(out.absolute()):
        drive = drive.relative_to(out.absolute())
    write_json(folder / MADE, {"key": key, "facts": facts, "source": str(drive)})


def take_measured(out: Path, work: Path, key: str) -> Summary | None:
    """Link the kept files to `work`, and return the summary of the motion.

    Returns None if `out` is no output folder of `steer measure`, or its key differs.
    """
    folder = out / FOLDER
    if not (folder / MADE).is_file():
        return None
    made = json.loads((folder / MADE).read_text(encoding="utf-8"))
    if made["key"] != key:
        return None
    for name in KEPT:
        link_or_copy(folder / name, work / name)
    return made["facts"]


def find_drive(path: Path) -> Path:
    """Return the drive of which `steer measure` made the folder `path`, or `path` if it did not."""
    made = path / FOLDER / MADE
    if not made.is_file():
        return path
    return path / json.loads(made.read_text(encoding="utf-8"))["source"]
