"""Import recordings: convert them to drives in data/raw/NAME, and write presets/NAME.yaml."""

import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from footage.convert import Converted, convert, describe_file, open_recording
from footage.lens import parse_numbers
from footage.settings import Options
from pipeline.base.errors import InputError, error_context
from pipeline.base.keys import file_hash
from pipeline.base.outputs import check_free
from pipeline.base.params import SPLITS, check_name
from pipeline.base.store import replacing, write_json, write_text
from pipeline.camera.pinhole import depth_limit
from pipeline.check import preset as presets
from pipeline.ingest.datasets.kitti import IMPORT

# File with the settings of a preset that do not depend on the recording.
TEMPLATE = Path(__file__).with_name("imported.yaml")
# Advice for a file that the import would replace.
OTHER_NAME = "Move it away, or pass another --name"


def write_import(
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
    files = [describe_file(path) for paths in groups for path in paths]
    check_replaceable(folder, preset, files)

    # Faults of all files and logs are found before the first image is decoded.
    recordings = []
    for paths, its_options in zip(groups, options, strict=True):
        recordings.append(open_recording(paths, its_options))

    with replacing(folder) as new:
        converted = convert(new, name, recordings, options[0], shares=shares)
        text = _preset_text(name, converted, options[0])
        record = {
            **converted.record,
            "recordings": files,
            "files": sorted(str(path.relative_to(new)) for path in new.rglob("*.*")),
            "preset_sha256": hashlib.sha256(text.encode()).hexdigest(),
        }
        write_json(new / IMPORT, record, sort_keys=False)
        # An earlier import is removed together with the temporary folder.
        if folder.exists():
            folder.rename(new.with_name("before"))
    write_text(preset, text)

    lines = []
    for split, drives in _split_drives(converted).items():
        lines += [f"{drive.folder.name}: {len(drive.times_s)} images, {split}" for drive in drives]
    lines += converted.notes
    if not converted.camera.height_known:
        lines.append("the speed's scale is not known: pass --camera-height METRES")
    return [*lines, f"next: make street && make {name}"]


def check_replaceable(folder: Path, preset: Path, recordings: Sequence[dict[str, Any]]) -> None:
    """Raise InputError unless the folder and the preset are free, or an import of `recordings`."""
    if not (folder / IMPORT).is_file():
        check_free(folder)
        check_free(preset)
        return
    record = json.loads((folder / IMPORT).read_text(encoding="utf-8"))
    written = {folder / name for name in (IMPORT, *record["files"])}
    # A file manager may leave a hidden file.
    others = [path for path in folder.rglob("[!.]*") if path.is_file() and path not in written]
    if others:
        raise InputError("is not by the import", min(others), OTHER_NAME)
    if record["recordings"] != recordings:
        names = ", ".join(file["name"] for file in record["recordings"])
        raise InputError(f"is an import of another recording, {names}", folder, OTHER_NAME)
    if preset.exists() and file_hash(preset) != record["preset_sha256"]:
        raise InputError("was edited since the import", preset, OTHER_NAME)


def read_shares(split: str) -> list[float]:
    """Return the shares of --split in %. Raises InputError."""
    shares = parse_numbers(split, (len(SPLITS),), "--split 60,20,20")
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


def _split_drives(converted: Converted) -> dict[str, list[Any]]:
    """Return split → drives, which are in turn for training, validation and test.

    If there are two drives, the second is for test.
    """
    drives = converted.drives
    if len(drives) == 2:
        return {"train": drives[:1], "val": [], "test": drives[1:]}
    return {split: drives[place :: len(SPLITS)] for place, split in enumerate(SPLITS)}


def _preset_text(name: str, converted: Converted, options: Options) -> str:
    """Return a preset with drives, and with models with and without measured motion as input."""
    settings = yaml.safe_load(TEMPLATE.read_text(encoding="utf-8"))
    names = {}
    for split, drives in _split_drives(converted).items():
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
