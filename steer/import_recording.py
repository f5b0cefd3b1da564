"""Import recordings with their logs: links in data/raw/NAME, and a preset that names their parts as
drives.
"""

import hashlib
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS, read_yaml
from pipeline.base.resume import ROOT, content_hash, is_by_desktop
from pipeline.base.store import replacing
from pipeline.camera.lens import depth_limit
from pipeline.check.preset import IMPORT, author_of, check_name_is_free, is_unedited, stamped
from pipeline.check.recording_logs import check_logs
from pipeline.ingest.datasets.recording import MOTION, SCAN, TIMES, WHEEL, usable
from pipeline.ingest.log import log_notes
from pipeline.ingest.recording import Recording
from pipeline.ingest.settings import FRAMES, VIDEO, Part
from pipeline.motion.horizon import noted_horizon

TEMPLATE = Path(__file__).with_name("imported.yaml")
OWN = rf"({VIDEO}[-.]|({FRAMES}|{WHEEL}|{MOTION}|{TIMES})$)"  # names of links
# What a checkout of the project has.
CHECKOUT = ("params.yaml", "dvc.yaml", "presets")
OTHER_NAME = "Move it away, or pass another --name"
GAP_S = 2.0  # left out between the parts of a split: neighbouring images are almost the same


def files_of(paths: Sequence[Path], part: Part, scan: pd.DataFrame) -> dict[str, Path | str]:
    """Return the content of the folder of a recording: name → file, or text."""
    names = [f"{VIDEO}-{number:02d}{path.suffix}" for number, path in enumerate(paths, 1)]
    if len(paths) == 1:
        names = [FRAMES if paths[0].is_dir() else f"{VIDEO}{paths[0].suffix}"]
    files: dict[str, Path | str] = dict(zip(names, paths, strict=True))
    for name, log in ((WHEEL, part.wheel), (MOTION, part.motion), (TIMES, part.times)):
        if log:
            files[name] = log
    return files | {SCAN: stamped(scan.to_csv(index=False), IMPORT)}


def cut_recording(
    recording: Recording, part: Part, files: Mapping[str, Path | str], shares: Sequence[float]
) -> list[tuple[Part, int]]:
    """Cut a recording with the options `part` into parts with `shares` of its time, each with its
    number of images.

    The horizon is estimated if `part` has none. Raises InputError if the sign or the clock of a log
    is wrong, no image is left, or a part is too short or has no angle.
    """
    time_s = recording.times_s
    logs = recording.logs
    within = usable(time_s, {}, part.start, part.end)
    used = check_logs(recording, part.start, part.end)
    row = part.horizon
    if row is None:
        frames = partial(recording.frames, within)
        row = noted_horizon(recording.path, frames, recording.camera, recording.notes)
    recording.notes.extend(log_notes(logs, time_s[within]))
    masks = cut(used, time_s, shares)
    if "wheel" in logs and not all(
        np.isfinite(logs["wheel"].at(time_s[rows])).any() for rows in masks
    ):
        raise InputError("a part has no image with an angle", "--wheel", "Check its times")

    hashes = {name: _hash(content) for name, content in files.items()}
    known = {
        "horizon": row and round(row, 2),
        "files": hashes,
        "wheel": None,
        "motion": None,
        "times": None,
    }
    parts = []
    for rows in masks:
        first_s, last_s = (time_s[rows] - time_s[0])[[0, -1]]
        span = {
            "start": math.floor(first_s * 1e3) / 1e3,
            "end": round(math.ceil(last_s * 1e3) / 1e3 + 0.002, 3),
        }
        parts.append((part.model_copy(update=known | span), int(rows.sum())))
    return parts


def _hash(content: Path | str) -> str:
    if isinstance(content, Path):
        return content_hash(content)
    return hashlib.sha256(content.encode()).hexdigest()


def cut(usable: np.ndarray, time_s: np.ndarray, shares: Sequence[float]) -> list[np.ndarray]:
    """Cut the `usable` images, bool [F], taken at `time_s` [F], into consecutive parts; return a
    mask of each.

    GAP_S are left out between two parts. Raises InputError if a part would have fewer than two
    images.
    """
    first_s, last_s = time_s[usable][[0, -1]]
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), math.inf]
    masks = [
        usable & (time_s >= begin) & (time_s < end)
        for begin, end in zip(edges_s[:-1], ends_s, strict=True)
    ]
    if short := next(
        (share for share, mask in zip(shares, masks, strict=True) if mask.sum() < 2), None
    ):
        problem = (
            f"the part of {short:g} % has fewer than 2 images ({last_s - first_s:.1f} s in all)"
        )
        fix = f"Pass a longer recording, or other shares: {GAP_S:g} s are left out between parts"
        raise InputError(problem, "--split", fix)
    return masks


def check_checkout(folder: Path) -> None:
    """Raise InputError if `folder` is in another checkout of the project than the code that runs,
    as in a worktree.
    """
    for place in (folder, *folder.parents):
        if all((place / name).exists() for name in CHECKOUT):
            if place.resolve() != ROOT:
                fix = (
                    f"Run it with this checkout's code: cd {place} && python -m steer.app import …"
                )
                raise InputError(f"is not the checkout of the installed steer, {ROOT}", place, fix)
            return


def check_free(preset: Path, recordings: Mapping[Path, Sequence[Path]]) -> None:
    """Raise InputError if the name of a preset or a folder of `recordings` is taken by anything but
    an earlier import.

    `recordings`: folder below data/raw → images that are imported to it. Copies of other images
    stay, as they may be the only ones.
    """
    check_name_is_free(preset.stem)
    if preset.exists() and not (author_of(preset) == IMPORT and is_unedited(preset)):
        raise InputError("is not as steer import wrote it", preset, OTHER_NAME)
    parts = read_yaml(preset)["ingest"]["recordings"].values() if preset.exists() else ()
    hashes = {
        (part["folder"], file): value for part in parts for file, value in part["files"].items()
    }
    for folder, images in recordings.items():
        if folder.parent.is_symlink() and not folder.parent.is_dir():
            raise InputError(
                "is a link to a folder that is missing",
                folder.parent,
                "Mount its disk, or remove the link",
            )
        if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
            raise InputError(
                "is a link or a file, expected a folder by steer import", folder, OTHER_NAME
            )
        for path in folder.glob("*"):
            own_link = path.is_symlink() and re.match(OWN, path.name)
            if not own_link and not (path.is_file() and is_by_desktop(path)):
                _check_copy(path, hashes.get((folder.name, path.name), ""), images)


def _check_copy(path: Path, expected: str, images: Sequence[Path]) -> None:
    """Raise InputError unless an import wrote a file or folder, with the hash `expected`, as a copy
    of these images.
    """
    # Of the folders in a folder, an import copies nothing; scan.csv may be of a preset that has
    # left.
    mine = next((below for below in path.glob("*") if below.is_dir()), None)
    is_scan = path.name == SCAN and is_unedited(path)
    if mine or not (is_scan or content_hash(path) == expected):
        raise InputError("is not as steer import wrote it", mine or path, OTHER_NAME)
    is_image = path.name.startswith((VIDEO, FRAMES))
    if is_image and expected not in [content_hash(image) for image in images if image.exists()]:
        raise InputError(
            "is a copy of another recording, maybe the only one", path, "Pass another --name"
        )


@contextmanager
def linked(recordings: Mapping[Path, Mapping[str, Path | str]], *, copy: bool) -> Iterator[None]:
    """Fill the folders of recordings with links to files, or copies; after the block they replace
    those before.

    `recordings`: folder → what :func:`files_of` returns.
    """
    folders = [folder.resolve() for folder in recordings]
    files = [
        path
        for content in recordings.values()
        for path in content.values()
        if isinstance(path, Path)
    ]
    for path in [path.resolve() for path in files]:
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
        for folder in filter(Path.is_dir, recordings):
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
    if path.is_dir():
        target.mkdir()
        for file in filter(Path.is_file, path.iterdir()):
            shutil.copyfile(file, target / file.name)
    else:
        shutil.copyfile(path, target)


def write_preset(
    path: Path, drives: Mapping[str, tuple[str, Part, int]], one: Recording, source: str
) -> None:
    """Write a preset of drives with two models, with and without measured motion as input.

    `drives`: name → split, part and number of images; `one`: of the recordings, which have one
    camera and rate. Motion that is the label (`source`) cannot be an input for the same frame, so
    visual labels are predicted a second ahead. A wheel's angle and measured motion may differ in
    scale: no base. Recorded angles do not scale with the scene.
    """
    settings = yaml.safe_load(TEMPLATE.read_text(encoding="utf-8"))
    own = {"times", "motion", "wheel"}  # paths of files that are in the folder
    settings["ingest"] |= {
        "drives": {
            split: [name for name, (of, *_) in drives.items() if of == split] for split in SPLITS
        },
        "recordings": {
            name: part.model_dump(by_alias=True, exclude_defaults=True, exclude=own)
            for name, (_, part, _) in drives.items()
        },
    }
    settings["labels"]["source"] = source
    settings["clouds"]["max_depth_m"] = float(round(depth_limit(one.camera)))
    if source == "visual":
        hz = (len(one.times_s) - 1) / float(np.ptp(one.times_s) or 1.0)
        settings["models"]["motion"]["horizon"] = settings["models"]["scene"]["horizon"] = max(
            1, round(hz)
        )
    if source == "wheel":
        settings["models"]["motion"]["base"] = "none"
        settings["train"]["rescale"] = 1.0
    text = f"# Networks of own recordings: make street, then make {path.stem}\n"
    text += yaml.safe_dump(settings, sort_keys=False)
    with replacing(path) as unfinished:
        unfinished.write_text(stamped(text, IMPORT), encoding="utf-8")
