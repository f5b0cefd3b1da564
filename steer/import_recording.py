"""Import recordings with their logs.

An import writes links to data/raw/NAME, and a preset whose drives are the parts of the recordings.
"""

import hashlib
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS, read_yaml
from pipeline.base.resume import ROOT, content_hash, is_by_desktop
from pipeline.base.store import replacing
from pipeline.camera.lens import depth_limit
from pipeline.check.preset import IMPORT, author_of, check_name_is_free, is_unedited, stamped
from pipeline.ingest.datasets.recording import MOTION, SCAN, TIMES, WHEEL, usable
from pipeline.ingest.log import Logs, log_notes
from pipeline.ingest.recording import Recording
from pipeline.ingest.settings import FRAMES, KITTI_NAMES, VIDEO, Part
from pipeline.labels.label import TURNING_RAD, steering_angle
from pipeline.motion.horizon import noted_horizon

# File with the settings of a preset that do not depend on the recording.
TEMPLATE = Path(__file__).with_name("imported.yaml")
# Pattern of the names of the links that an import makes.
LINKS = rf"({VIDEO}[-.]|({FRAMES}|{WHEEL}|{MOTION}|{TIMES})$)"
# Files and folders by which a checkout of the project is recognised.
CHECKOUT = ("params.yaml", "dvc.yaml", "presets")
# Advice for a file that the import would replace.
OTHER_NAME = "Move it away, or pass another --name"
# Wheelbase in metres of a typical car, by which speed and yaw rate become an angle.
CAR_M = 2.7
# Seconds left out between the parts of a split, as neighbouring images are almost the same.
GAP_S = 2.0


class ImportedDrive(NamedTuple):
    """A part of a recording as a drive of the preset."""

    name: str
    split: str
    part: Part
    images: int


def name_files(paths: Sequence[Path], part: Part, scan: pd.DataFrame) -> dict[str, Path | str]:
    """Return the content of a recording's folder: name → path of a file to link, or text."""
    files: dict[str, Path | str] = {}
    if len(paths) > 1:
        for number, path in enumerate(paths, 1):
            files[f"{VIDEO}-{number:02d}{path.suffix}"] = path
    elif paths[0].is_dir():
        files[FRAMES] = paths[0]
    else:
        files[f"{VIDEO}{paths[0].suffix}"] = paths[0]

    for name, log in ((WHEEL, part.wheel), (MOTION, part.motion), (TIMES, part.times)):
        if log:
            files[name] = log
    files[SCAN] = stamped(scan.to_csv(index=False), IMPORT)
    return files


def cut_recording(
    recording: Recording, part: Part, files: Mapping[str, Path | str], shares: Sequence[float]
) -> list[tuple[Part, int]]:
    """Return the parts of a recording with `shares` of its time, each with its number of images.

    `part` has the options of the recording. If it has no horizon, the horizon is estimated. Raises
    InputError if no image is left, or if a part is too short or has no angle.
    """
    time_s = recording.times_s
    logs = recording.logs
    within = usable(time_s, {}, part.start, part.end)
    used = usable(time_s, logs, part.start, part.end)
    if not used.any():
        problem = "no image from --start to --end is left, or none with motion"
        raise InputError(problem, fix="Change --start, --end or --offset")
    row = part.horizon
    if row is None:
        frames = partial(recording.frames, within)
        row = noted_horizon(recording.path, frames, recording.camera, recording.notes)
    recording.notes.extend(log_notes(logs, time_s[within]))
    recording.notes.extend(turn_notes(logs, time_s[within]))

    # All parts have the files of the recording. Logs and times are among them.
    changes: dict[str, Any] = {
        "horizon": None if row is None else round(row, 2),
        "files": {name: _hash(content) for name, content in files.items()},
        "wheel": None,
        "motion": None,
        "times": None,
    }
    parts = []
    for rows in cut(used, time_s, shares):
        if "wheel" in logs and not np.isfinite(logs["wheel"].at(time_s[rows])).any():
            raise InputError("a part has no image with an angle", "--wheel", "Check its times")
        # Start and end are whole milliseconds. The last image must be before the end by more than
        # the tolerance of 1 ms (ROUNDING_S), so the end is 2 ms after it.
        part_s = time_s[rows] - time_s[0]
        changes["start"] = math.floor(part_s[0] * 1e3) / 1e3
        changes["end"] = round(math.ceil(part_s[-1] * 1e3) / 1e3 + 0.002, 3)
        parts.append((part.model_copy(update=changes), int(rows.sum())))
    return parts


def turn_notes(logs: Logs, time_s: np.ndarray) -> Iterator[str]:
    """Yield for each log how many of the images at `time_s` [F] turn."""
    for kind, log in logs.items():
        values = log.at(time_s)
        angle_rad = values[0]
        if kind == "motion":
            speed_mps, yaw_rate_radps = values
            angle_rad = steering_angle(yaw_rate_radps, speed_mps, CAR_M)
        turning = np.sum(np.abs(angle_rad) > TURNING_RAD)  # false for NaN
        counts = f"{turning:,} of {len(time_s):,} images"
        yield f"{counts} turn by {log.name} (radius below 135 m)"


def _hash(content: Path | str) -> str:
    """Return the SHA-256 of a file or folder, or of a text."""
    if isinstance(content, Path):
        return content_hash(content)
    return hashlib.sha256(content.encode()).hexdigest()


def cut(usable: np.ndarray, time_s: np.ndarray, shares: Sequence[float]) -> list[np.ndarray]:
    """Cut the `usable` images, bool [F], taken at `time_s` [F], into consecutive parts.

    Between two parts, GAP_S seconds are left out. Returns a mask [F] for each part. Raises
    InputError if a part would have fewer than two images.
    """
    first_s, last_s = time_s[usable][[0, -1]]
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), math.inf]
    masks = []
    for share, begin_s, end_s in zip(shares, edges_s[:-1], ends_s, strict=True):
        mask = usable & (time_s >= begin_s) & (time_s < end_s)
        if mask.sum() < 2:
            length = f"{last_s - first_s:.1f} s in all"
            problem = f"the part of {share:g} % has fewer than 2 images ({length})"
            gap = f"{GAP_S:g} s are left out between parts"
            raise InputError(problem, "--split", f"Pass a longer recording, or other shares: {gap}")
        masks.append(mask)
    return masks


def name_drives(name: str, parts: Sequence[tuple[Part, int]], *, each: bool) -> list[ImportedDrive]:
    """Return the parts as drives, in turn for training, validation and test.

    If there are two parts, the second is for test. If `name` has the pattern of KITTI's names, it
    is the name of the first drive, and the next drives have the next numbers.
    """
    drives = []
    for number, (part, images) in enumerate(parts):
        split = SPLITS[number % len(SPLITS)]
        if len(parts) == 2 and number == 1:
            split = "test"
        drive = f"{name}-{split}"
        if each:
            drive = f"{name}-{number + 1}"
        if KITTI_NAMES.fullmatch(name):
            drive = f"{name[:-4]}{int(name[-4:]) + number:04d}"
        drives.append(ImportedDrive(drive, split, part, images))
    return drives


def check_checkout(folder: Path) -> None:
    """Raise InputError if `folder` is in another checkout, or worktree, than the running code."""
    for place in (folder, *folder.parents):
        if all((place / name).exists() for name in CHECKOUT):
            if place.resolve() != ROOT:
                command = f"cd {place} && python -m steer.app import …"
                fix = f"Run it with this checkout's code: {command}"
                raise InputError(f"is not the checkout of the installed steer, {ROOT}", place, fix)
            return


def check_free(preset: Path, recordings: Mapping[Path, Sequence[Path]]) -> None:
    """Raise InputError if a preset or a folder of `recordings` is not by an earlier import.

    `recordings` maps folders below data/raw to the images that are imported to them. Raises
    InputError also for a folder with copies of other images, as they may be the only copies.
    """
    check_name_is_free(preset.stem)
    hashes = {}
    if preset.exists():
        if author_of(preset) != IMPORT or not is_unedited(preset):
            raise InputError("is not as steer import wrote it", preset, OTHER_NAME)
        for part in read_yaml(preset)["ingest"]["recordings"].values():
            for file, value in part["files"].items():
                hashes[part["folder"], file] = value

    for folder, images in recordings.items():
        if folder.parent.is_symlink() and not folder.parent.is_dir():
            problem = "is a link to a folder that is missing"
            raise InputError(problem, folder.parent, "Mount its disk, or remove the link")
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            problem = "is a link or a file, expected a folder by steer import"
            raise InputError(problem, folder, OTHER_NAME)
        for path in folder.glob("*"):
            is_link = path.is_symlink() and re.match(LINKS, path.name)
            is_ignored = path.is_file() and is_by_desktop(path)
            if not is_link and not is_ignored:
                _check_copy(path, hashes.get((folder.name, path.name), ""), images)


def _check_copy(path: Path, expected: str, images: Sequence[Path]) -> None:
    """Raise InputError unless an import wrote a file or folder as a copy of these images.

    `expected` is its hash by the preset, or empty.
    """
    # An import does not copy folders inside a folder, so they are the user's.
    for child in path.glob("*"):
        if child.is_dir():
            raise InputError("is not as steer import wrote it", child, OTHER_NAME)

    # The preset with the hash of scan.csv may be gone, but its stamp shows that it is unedited.
    is_scan = path.name == SCAN and is_unedited(path)
    if not is_scan and content_hash(path) != expected:
        raise InputError("is not as steer import wrote it", path, OTHER_NAME)

    if path.name.startswith((VIDEO, FRAMES)):
        hashes = [content_hash(image) for image in images if image.exists()]
        if expected not in hashes:
            problem = "is a copy of another recording, maybe the only one"
            raise InputError(problem, path, "Pass another --name")


@contextmanager
def linked(recordings: Mapping[Path, Mapping[str, Path | str]], *, copy: bool) -> Iterator[None]:
    """Fill the folders of recordings with links to files, or copies, and run the block.

    After the block, they replace the folders of an earlier import. `recordings` maps folders to
    their contents by :func:`name_files`.
    """
    folders = [folder.resolve() for folder in recordings]
    sources = [source for content in recordings.values() for source in content.values()]
    paths = [source.resolve() for source in sources if isinstance(source, Path)]
    for path in paths:
        if any(path.is_relative_to(folder) for folder in folders):
            raise InputError("is in a folder that this import replaces", path, OTHER_NAME)

    with ExitStack() as stack:
        for folder, content in recordings.items():
            new = stack.enter_context(replacing(folder))
            new.mkdir()
            for name, source in content.items():
                if isinstance(source, str):
                    (new / name).write_text(source, encoding="utf-8")
                elif copy or not _link(new / name, source):
                    _copy(source, new / name)
        yield
        for folder in recordings:
            if folder.is_dir():
                shutil.rmtree(folder)


def _link(link: Path, path: Path) -> bool:
    """Make a link, or print a note and return False on a disk without links, such as exFAT."""
    try:
        link.symlink_to(path.resolve())
    except OSError as error:
        print(f"{path.name} is copied: a link cannot be made there ({error.strerror})")
        return False
    return True


def _copy(path: Path, target: Path) -> None:
    """Copy a file, or a folder without the folders in it."""
    if not path.is_dir():
        shutil.copyfile(path, target)
        return
    target.mkdir()
    for file in path.iterdir():
        if file.is_file():
            shutil.copyfile(file, target / file.name)


def write_preset(
    path: Path, drives: Sequence[ImportedDrive], recording: Recording, options: Part
) -> None:
    """Write a preset with drives, and with models with and without measured motion as input.

    `recording` and `options` are those of the first recording. The others have the same camera,
    rate and kinds of logs.
    """
    settings = yaml.safe_load(TEMPLATE.read_text(encoding="utf-8"))
    names = dict[str, list[str]]({split: [] for split in SPLITS})
    parts = {}
    for drive in drives:
        names[drive.split].append(drive.name)
        parts[drive.name] = drive.part.model_dump(by_alias=True, exclude_defaults=True)
    settings["ingest"]["drives"] = names
    settings["ingest"]["recordings"] = parts
    settings["clouds"]["max_depth_m"] = float(round(depth_limit(recording.camera)))

    models = settings["models"]
    if options.motion:
        settings["labels"] = {"source": "ingest", "angle": "computed"}
    elif options.wheel:
        settings["labels"] = {"source": "motion", "angle": "recorded"}
        # The wheel's angle and measured motion may differ in scale, so measured motion is no base
        # to which a prediction is added. Recorded angles do not change with the scale of the scene,
        # so training must not scale both.
        models["motion"]["base"] = "none"
        settings["train"]["rescale"] = 1.0
    else:
        settings["labels"] = {"source": "motion", "angle": "computed"}
        # Measured motion cannot be the label and an input of the same frame, so labels are
        # predicted a second ahead.
        hz = (len(recording.times_s) - 1) / float(np.ptp(recording.times_s))
        for model in ("motion", "scene"):
            models[model]["horizon"] = max(1, round(hz))

    text = f"# Networks of own recordings: make street, then make {path.stem}\n"
    text += yaml.safe_dump(settings, sort_keys=False)
    with replacing(path) as unfinished:
        unfinished.write_text(stamped(text, IMPORT), encoding="utf-8")
