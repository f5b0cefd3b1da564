"""Import recordings with their logs: links in data/raw/NAME, and a preset that names their parts as drives."""

import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS, read
from pipeline.base.resume import ROOT, content_hash, is_of_desktop
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera
from pipeline.camera.lens import depth_limit
from pipeline.check.preset import IMPORT, is_unedited, stamped
from pipeline.ingest.datasets.recording import FRAMES, MOTION, TIMES, VIDEO, WHEEL, open_part, usable
from pipeline.ingest.log import Logs
from pipeline.ingest.media import Recording
from pipeline.ingest.settings import Part
from pipeline.labels.agreement import MOVES_MPS, Noise, Pair, compare
from pipeline.labels.comparison import UNKNOWN, judge_turns
from pipeline.labels.label import Labels
from pipeline.motion.horizon import noted_horizon, turn_rates
from pipeline.motion.step import TYPICAL_MPS

OWN = rf"({VIDEO}[-.]|({FRAMES}|{WHEEL}|{MOTION}|{TIMES})$)"  # names of links
GAP_S = 2.0  # left out between the parts of a split: neighbouring images are almost the same
# Standard deviation of a yaw rate by the rotation between two images: it is 0.010 to 0.016 on five real recordings.
TURN_SIGMA_RADPS = 0.012
# A car's wheelbase, for the angle at a typical speed.
CAR_M = 2.7


@dataclass
class Imported:
    """A recording with its logs, cut into parts."""

    folder: str  # of data/raw
    files: Mapping[str, Path]  # name in the folder → file
    parts: list[tuple[Part, int]]  # each with its number of images
    recording: Recording
    camera: Camera


def open_recording(
    paths: Sequence[Path], log_files: Mapping[str, Path | None], part: Part, shares: Sequence[float]
) -> Imported:
    """Read a recording by the options of a `part` without files, and cut it into parts with `shares` of its time.

    `log_files`: name in the folder → file. The horizon is estimated if `part` has none. Raises InputError if anything
    cannot be used, the sign or the clock of a log is wrong, no image is left, or a part is too short or has no angle.
    """
    names = [f"{VIDEO}-{number:02d}{path.suffix}" for number, path in enumerate(paths, 1)]
    if len(paths) == 1:
        names = [FRAMES if paths[0].is_dir() else f"{VIDEO}{paths[0].suffix}"]
    files = dict(zip(names, paths, strict=True)) | {name: path for name, path in log_files.items() if path}
    recording, camera, logs = open_part(part, files)
    time_s = recording.times_s
    within, used = (usable(time_s, some, part.start, part.end) for some in (Logs(), logs))
    _check_logs(recording, camera, logs, within)
    row = part.horizon
    if row is None:
        row = noted_horizon(recording.path, partial(recording.frames, within), camera, recording.notes)
    if not used.any():
        problem = "no image from --start to --end is left, or none with motion"
        raise InputError(problem, fix="Change --start, --end or --offset")
    recording.notes.extend(logs.notes(time_s[within]))
    masks = cut(used, time_s, shares)
    if logs.wheel and not all(np.isfinite(logs.wheel.at(time_s[rows])).any() for rows in masks):
        raise InputError("a part has no image with an angle", "--wheel", "Check its times")
    hashes = {name: content_hash(path) for name, path in files.items()}
    parts = []
    for rows in masks:
        first_s, last_s = (time_s[rows] - time_s[0])[[0, -1]]
        span = {"start": math.floor(first_s * 1e3) / 1e3, "end": round(math.ceil(last_s * 1e3) / 1e3 + 0.002, 3)}
        known = {"horizon": row and round(row, 2), "files": hashes}
        parts.append((part.model_copy(update=known | span), int(rows.sum())))
    return Imported(part.folder, files, parts, recording, camera)


def _check_logs(recording: Recording, camera: Camera, logs: Logs, within: np.ndarray) -> None:
    """Compare logs with the turns of the images `within` start and end, bool [F]; add a note if too few images turn.

    Raises InputError if the sign or the clock of a log is wrong. The images give no speed: the angle of a wheel is
    compared with that of a car at TYPICAL_MPS.
    """
    if not (logs.motion or logs.wheel):
        return
    time_s = recording.times_s
    if logs.motion:
        speed_mps = logs.motion.at(time_s[within])[0]
        if np.sum(speed_mps < -MOVES_MPS) > np.sum(speed_mps > MOVES_MPS):
            raise InputError("speed_mps is negative in most images: forward is positive", logs.motion.name)
    measured_radps = turn_rates(recording.frames, camera, time_s, within)
    measured = _labels(measured_radps * CAR_M / TYPICAL_MPS, measured_radps)
    noise = Noise(np.full(len(time_s), TURN_SIGMA_RADPS), np.full(len(time_s), np.nan))
    unknown = np.full(len(time_s), np.nan)
    for log, column in ((logs.motion, "yaw_rate_radps"), (logs.wheel, "wheel_rad")):
        if not log:
            continue
        recorded = _labels(unknown, log.at(time_s)[1]) if log is logs.motion else _labels(log.at(time_s)[0], unknown)
        problem, fix = judge_turns(compare([Pair(time_s, recorded, measured, noise)]), column)
        if problem == UNKNOWN:
            recording.notes.append(f"{log.name} cannot be compared with the turns of the images: {problem}")
        elif problem:
            raise InputError(problem, log.name, fix)


def _labels(steering_rad: np.ndarray, yaw_rate_radps: np.ndarray) -> Labels:
    known = np.isfinite(steering_rad) | np.isfinite(yaw_rate_radps)
    return Labels(steering_rad, known, np.full(len(known), np.nan), yaw_rate_radps)


def cut(usable: np.ndarray, time_s: np.ndarray, shares: Sequence[float]) -> list[np.ndarray]:
    """Cut the `usable` images, bool [F], taken at `time_s` [F], into consecutive parts; return a mask of each.

    GAP_S are left out between two parts. Raises InputError if a part would have fewer than two images.
    """
    first_s, last_s = time_s[usable][[0, -1]]
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), math.inf]
    masks = [usable & (time_s >= begin) & (time_s < end) for begin, end in zip(edges_s[:-1], ends_s, strict=True)]
    if short := next((share for share, mask in zip(shares, masks, strict=True) if mask.sum() < 2), None):
        problem = f"the part of {short:g} % has fewer than 2 images ({last_s - first_s:.1f} s in all)"
        fix = f"Pass a longer recording, or other shares: {GAP_S:g} s are left out between parts"
        raise InputError(problem, "--split", fix)
    return masks


def check_free(preset: Path, folders: Sequence[Path]) -> None:
    """Raise InputError if the name of a preset or one of its folders is taken by anything but an earlier import."""
    if re.search(rf"^{re.escape(preset.stem)}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE):
        raise InputError("is a target of make", preset.stem, "Pass another --name")
    if preset.exists() and not is_unedited(preset):
        raise InputError("is not as steer import wrote it", preset, "Move it away, or pass another --name")
    known = read(preset)["ingest"]["recordings"].values() if preset.exists() else ()
    hashes = {(part["folder"], file): value for part in known for file, value in part["files"].items()}
    for path in [path for folder in folders for path in folder.glob("*") if not is_of_desktop(path)]:
        own_link = path.is_symlink() and re.match(OWN, path.name)
        if not own_link and content_hash(path) != hashes.get((path.parent.name, path.name)):
            raise InputError("is not as steer import wrote it", path, "Move it away, or pass another --name")


@contextmanager
def linked(recordings: Sequence[Imported], raw: Path, *, copy: bool) -> Iterator[None]:
    """Make links to the files of recordings, or copies; after the block they replace those of an earlier import."""
    folders = [(raw / one.folder).resolve() for one in recordings]
    for path in [path.resolve() for one in recordings for path in one.files.values()]:
        if any(path.is_relative_to(folder) for folder in folders):
            raise InputError("is in a folder that this import replaces", path, "Move it away, or pass another --name")
    with ExitStack() as stack:
        for one in recordings:
            new = stack.enter_context(replacing(raw / one.folder))
            new.mkdir()
            for name, path in one.files.items():
                if copy or not _link(new / name, path):
                    _copy(path, new / name)
        yield
        for one in recordings:
            if (raw / one.folder).is_dir():
                shutil.rmtree(raw / one.folder)


def _link(link: Path, path: Path) -> bool:
    """Make a link, or print a note and return False on a disk without links, such as exFAT."""
    try:
        link.symlink_to(path.resolve())
    except OSError as error:
        print(f"{path.name} is copied: a link cannot be made there ({error.strerror})")
        return False
    return True


def _copy(path: Path, target: Path) -> None:
    if path.is_dir():
        shutil.copytree(path, target)
    else:
        shutil.copyfile(path, target)


def write_preset(path: Path, drives: Mapping[str, tuple[str, Part, int]], one: Imported, source: str) -> None:
    """Write a preset of drives with two models, with and without measured motion as input.

    `drives`: name → split, part and number of images; `one`: of the recordings, which have one camera and rate. Motion
    that is the label (`source`) cannot be an input for the same frame, so visual labels are predicted a second ahead. A
    wheel's angle and measured motion may differ in scale: no base.
    """
    network = {"input": "depth", "spatial": "gnn", "temporal": "ncp", "semantics": 0.0, "equivariant": True}
    if source == "visual":
        hz = (len(one.recording.times_s) - 1) / float(np.ptp(one.recording.times_s) or 1.0)
        network["horizon"] = max(1, round(hz))
    settings: dict[str, Any] = {
        "ingest": {
            "image_size": [192, 640],  # the depth network's training size
            "lidar": False,
            "drives": {split: [name for name, (of, *_) in drives.items() if of == split] for split in SPLITS},
            "recordings": {name: part.model_dump(exclude_defaults=True) for name, (_, part, _) in drives.items()},
        },
        "encoder": {"backbone": "street", "weights": "weights/street/encoder.pt", "epochs": 0},
        "labels": {"source": source},
        "clouds": {"max_depth_m": float(round(depth_limit(one.camera)))},
        "graphs": {"*": None, "depth": {"source": "clouds/pseudo", "points": 1000, "k": 6}},
        "models": {
            "*": None,
            "motion": network | {"motion": "visual"} | ({"base": "none"} if source == "wheel" else {}),
            "scene": network,
        },
        # A single recording is small. Recorded angles do not scale with the scene.
        "train": {"epochs": 40} | ({"rescale": 1.0} if source == "wheel" else {}),
    }
    text = f"# Networks of own recordings: make street, then make {path.stem}\n"
    text += yaml.safe_dump(settings, sort_keys=False)
    with replacing(path) as unfinished:
        unfinished.write_text(stamped(text, IMPORT), encoding="utf-8")
