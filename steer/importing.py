"""Import a recording: convert it to drives in data/raw/NAME, and write presets/NAME.yaml."""

import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from pipeline.jobs.outputs import check_free

from footage.convert import Converted, convert, describe_file, open_recording
from footage.lens import parse_numbers
from footage.settings import Options
from pipeline.base.errors import InputError, error_context
from pipeline.base.hashes import file_hash
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
    name: str, paths: Sequence[Path], options: Options, shares: Sequence[float]
) -> list[str]:
    """Write the drives and the preset `name` of a recording, and return lines for the user.

    `paths` are the files of the recording, and `shares` those of its time for SPLITS, in %. Raises
    InputError for faulty files, and if the import would replace anything but an import of the same
    recording.
    """
    with error_context("--name"):
        check_name(name)
    presets.check_name_is_free(name)
    preset = presets.PRESETS / f"{name}.yaml"
    folder = presets.PRESETS.parent / "data/raw" / name
    files = [describe_file(path) for path in paths]
    check_replaceable(folder, preset, files)

    # Faults of all files and logs are found before the first image is decoded.
    recording = open_recording(paths, options)

    with replacing(folder) as new:
        converted = convert(new, name, recording, options, shares=shares)
        text = _preset_text(name, converted, options)
        record = {
            **converted.record,
            "files": sorted(str(path.relative_to(new)) for path in new.rglob("*.*")),
            "csv_sha256": {
                str(path.relative_to(new)): file_hash(path) for path in sorted(new.rglob("*.csv"))
            },
            "preset_sha256": hashlib.sha256(text.encode()).hexdigest(),
        }
        write_json(new / IMPORT, record, sort_keys=False)
        # An earlier import is removed together with the temporary folder.
        if folder.exists():
            folder.rename(new.with_name("before"))
    write_text(preset, text)

    lines = []
    for split, drive in zip(SPLITS, converted.drives, strict=True):
        lines.append(f"{drive.folder.name}: {len(drive.times_s)} images, {split}")
    lines += converted.notes
    if not converted.camera.height_known:
        lines.append("the speed's scale is not known: pass --camera-height METRES")
    return [*lines, f"next: make street && make {name}"]


def check_replaceable(folder: Path, preset: Path, files: Sequence[dict[str, Any]]) -> None:
    """Raise InputError unless the folder and the preset are free, or an import of `files`."""
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
    if record["recordings"] != files:
        names = ", ".join(file["name"] for file in record["recordings"])
        raise InputError(f"is an import of another recording, {names}", folder, OTHER_NAME)

    # Values and settings that a user edited are kept. Imports by older versions lack the hashes of
    # the values.
    hashes = {folder / name: sha256 for name, sha256 in record.get("csv_sha256", {}).items()}
    hashes[preset] = record["preset_sha256"]
    for path, sha256 in hashes.items():
        if path.exists() and file_hash(path) != sha256:
            raise InputError("was edited since the import", path, OTHER_NAME)


def read_shares(split: str) -> list[float]:
    """Return the shares of --split in %. Raises InputError."""
    shares = parse_numbers(split, (len(SPLITS),), "--split 60,20,20")
    if min(shares) <= 0 or not math.isclose(sum(shares), 100):
        problem = f"expected shares above 0 with the sum 100, got {split}"
        raise InputError(problem, "--split", "Pass 60,20,20")
    return shares


def _preset_text(name: str, converted: Converted, options: Options) -> str:
    """Return a preset with drives, and with models with and without measured motion as input."""
    settings = yaml.safe_load(TEMPLATE.read_text(encoding="utf-8"))
    names = {}
    for split, drive in zip(SPLITS, converted.drives, strict=True):
        names[split] = [drive.folder.name.removesuffix("_sync")]
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
