"""Import recordings: convert them to drives in data/raw/NAME, and write presets/NAME.yaml."""

import hashlib
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from footage.convert import Converted, convert, describe, open_recording
from footage.lens import numbers
from footage.settings import Options
from pipeline.base.checkout import is_checkout
from pipeline.base.errors import InputError, error_context
from pipeline.base.keys import ROOT, file_hash, list_files
from pipeline.base.outputs import hold_lock
from pipeline.base.params import SPLITS, check_name
from pipeline.base.store import replacing, write_json, write_text
from pipeline.camera.pinhole import depth_limit
from pipeline.check import preset as presets
from pipeline.ingest.datasets.kitti import IMPORT

# File with the settings of a preset that do not depend on the recording.
TEMPLATE = Path(__file__).with_name("imported.yaml")
# Files and folders by which a checkout of the project is recognised.
CHECKOUT = ("params.yaml", "dvc.yaml", "presets")
# Advice for a file that the import would replace.
OTHER_NAME = "Move it away, or pass another --name"


def take(
    name: str,
    groups: Sequence[Sequence[Path]],
    options: Sequence[Options],
    shares: Sequence[float],
) -> list[str]:
    """Write the drives and the preset `name` of recordings, and return lines for the user.

    Each of the `groups` has the files of a recording, and each recording its `options`, which
    differ in the logs only. Raises InputError for faulty files, and if the import would replace
    anything but an import of the same recordings.
    """
    with error_context("--name"):
        check_name(name)
    presets.check_name_is_free(name)
    preset = presets.PRESETS / f"{name}.yaml"
    folder = presets.PRESETS.parent / "data/raw" / name

    # Faults of all files and logs are found before the first image is decoded.
    recordings = []
    for paths, its_options in zip(groups, options, strict=True):
        recordings.append(open_recording(paths, its_options))
    files = [describe(path) for paths in groups for path in paths]

    folder.parent.mkdir(parents=True, exist_ok=True)
    hidden = folder.with_name(f".{name}")
    with hold_lock(folder, f"{hidden}.lock"):
        for leftover in folder.parent.glob(f"{hidden.name}.????????.tmp"):
            shutil.rmtree(leftover)
        check_replaceable(folder, preset, files)
        with replacing(folder) as new:
            converted = convert(new, name, recordings, options[0], shares=shares)
            text = preset_text(name, converted, options[0])
            # The preset may have been edited during the conversion.
            check_replaceable(folder, preset, files)
            hashes = [hashlib.sha256(text.encode()).hexdigest()]
            if preset.exists():
                # A killed import may leave the earlier preset.
                hashes.append(file_hash(preset))
            record = {**converted.record, "preset_sha256": hashes}
            write_json(new / IMPORT, record, sort_keys=False)
            # An earlier import is removed together with the temporary folder.
            if folder.exists():
                folder.rename(new.with_name("before"))
        write_text(preset, text)

    lines = []
    for split, drives in split_drives(converted).items():
        lines += [f"{drive.folder.name}: {len(drive.images)} images, {split}" for drive in drives]
    lines += converted.notes
    lines += [f"doubt: {text}" for text in converted.doubts]
    if not converted.camera.height_known:
        lines.append("the speed's scale is not known: pass --camera-height METRES")
    return [*lines, f"next: make street && make {name}"]


def check_checkout(folder: Path) -> None:
    """Raise InputError without a checkout, or if `folder` is in another one than the code."""
    if not is_checkout():
        fix = "Clone it: git clone …; then run make setup and .venv/bin/steer import there"
        raise InputError("steer import needs a checkout of the project", fix=fix)
    for place in (folder, *folder.parents):
        if all((place / name).exists() for name in CHECKOUT):
            if place.resolve() != ROOT:
                command = f"cd {place} && python -m steer.app import …"
                fix = f"Run it with this checkout's code: {command}"
                raise InputError(f"is not the checkout of the installed steer, {ROOT}", place, fix)
            return


def check_replaceable(folder: Path, preset: Path, recordings: Sequence[dict[str, Any]]) -> None:
    """Raise InputError unless the folder and the preset are free, or an import of `recordings`."""
    if folder.is_file():
        raise InputError("is a file, expected a folder", folder, OTHER_NAME)
    files = {*list_files(folder)}
    if not files:
        if preset.exists():
            raise InputError("exists already", preset, OTHER_NAME)
        return
    if folder / IMPORT not in files:
        raise InputError("has files that no import wrote", folder, OTHER_NAME)
    record = json.loads((folder / IMPORT).read_text(encoding="utf-8"))
    others = files - {folder / name for name in (IMPORT, *record["files"])}
    if others:
        raise InputError("is not by the import", min(others), OTHER_NAME)
    if record["recordings"] != recordings:
        names = ", ".join(file["name"] for file in record["recordings"])
        raise InputError(f"is an import of another recording, {names}", folder, OTHER_NAME)
    if preset.exists() and file_hash(preset) not in record["preset_sha256"]:
        raise InputError("was edited since the import", preset, OTHER_NAME)


def read_shares(split: str) -> list[float]:
    """Return the shares of --split in %. Raises InputError."""
    shares = numbers(split, (len(SPLITS),), "--split 60,20,20")
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        problem = f"expected shares above 0 with the sum 100, got {split}"
        raise InputError(problem, "--split", "Pass 60,20,20")
    return shares


def divide_logs(logs: Sequence[Path] | None, option: str, count: int) -> Sequence[Path | None]:
    """Return the log of each of `count` recordings. Raises InputError for another number."""
    if not logs:
        return [None] * count
    if len(logs) != count:
        problem = f"expected {count}, one per recording (got {len(logs)})"
        raise InputError(problem, option, "With --each, each path is a recording")
    return logs


def split_drives(converted: Converted) -> dict[str, list[Any]]:
    """Return split → drives, which are in turn for training, validation and test.

    If there are two drives, the second is for test.
    """
    drives = converted.drives
    if len(drives) == 2:
        return {"train": drives[:1], "val": [], "test": drives[1:]}
    return {split: drives[place :: len(SPLITS)] for place, split in enumerate(SPLITS)}


def preset_text(name: str, converted: Converted, options: Options) -> str:
    """Return a preset with drives, and with models with and without measured motion as input."""
    settings = yaml.safe_load(TEMPLATE.read_text(encoding="utf-8"))
    names = {}
    for split, drives in split_drives(converted).items():
        names[split] = [drive.folder.name.removesuffix("_sync") for drive in drives]
    settings["ingest"]["drives"] = names
    settings["clouds"]["max_depth_m"] = float(round(depth_limit(converted.camera)))

    labels = {"source": "motion", "angle": "computed"}
    models = settings["models"]
    if options.motion:
        labels["source"] = "ingest"
    if options.wheel:
        labels["angle"] = "recorded"
        # The wheel's angle and measured motion may differ in scale, so measured motion is no base
        # to which a prediction is added. Recorded angles do not change with the scale of the scene,
        # so training must not scale both.
        models["motion"]["base"] = "none"
        settings["train"]["rescale"] = 1.0
    if not options.motion and not options.wheel:
        # Measured motion cannot be the label and an input of the same frame, so labels are
        # predicted a second ahead.
        for model in ("motion", "scene"):
            models[model]["horizon"] = max(1, round(converted.hz))
    settings["labels"] = labels
    text = yaml.safe_dump(settings, sort_keys=False)
    return f"# Networks of own recordings: make street, then make {name}\n{text}"
