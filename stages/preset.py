"""``make NAME``: run presets/NAME.yaml in runs/NAME, a copy of the code with its own DVC cache.

This file is no stage. It merges settings, copies files and starts DVC.
"""

import io
import json
import shutil
import subprocess
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.jobs import console
from pipeline.jobs.origin import RUN, describe_origin, format_duration, read_run
from pipeline.jobs.outputs import check_free, hold_lock, remove_path
from pipeline.jobs.revision import CODE, revision

from pipeline.base.checkout import CHECKOUT, ROOT
from pipeline.base.errors import InputError
from pipeline.base.hashes import digest, file_hash, list_files
from pipeline.base.params import parse, read_yaml
from pipeline.base.store import naming_full_disk, replacing, write_json, write_text
from pipeline.check.preset import PRESETS, check_name_is_free
from pipeline.check.settings import Params
from pipeline.encoder.settings import Encoder
from pipeline.encoder.weights import weights_hash
from pipeline.ingest.datasets.kitti import IMPORT
from pipeline.ingest.settings import Ingest

# File of settings into which presets are merged.
PARAMS = ROOT / "params.yaml"


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/")],
    stages: Annotated[list[str] | None, typer.Argument(help="default: all")] = None,
) -> None:
    """Run stages with a preset. If all have run, copy the report to data/report/PRESET.*.

    Raises InputError if the preset is running already, or would replace other files.
    """
    if not stages:
        check_name_is_free(name)
    settings = merge_preset(name, Path("params.yaml"))
    # DVC watches neither weights nor data/raw. It notices other files there by their hashes.
    weights = weights_hash(parse(Encoder, settings["encoder"], "encoder"))
    if weights:
        settings["encoder"]["weights_sha256"] = weights
    imports = hash_imports(parse(Ingest, settings["ingest"], "ingest"), Path("data/raw"))
    if imports:
        settings["ingest"]["imports_sha256"] = imports

    run = Path("runs") / name
    record = {
        "preset": name,
        "revision": revision(Path.cwd()),
        "started_s": time.time(),
        "settings": read_yaml(PRESETS / f"{name}.yaml"),
    }
    texts = {
        "params.yaml": to_yaml(settings, f"make {name}: params.yaml with presets/{name}.yaml"),
        str(CHECKOUT): str(Path.cwd()),
    }
    run.parent.mkdir(exist_ok=True)
    with hold_lock(run, f"{run}.lock"):
        with naming_full_disk(run):
            write_run(run, record, texts)
        run_dvc(run, stages or [])
        if not stages:
            publish_report(run, Path("data/report"), name)


def merge_preset(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of file `params` with the changes of the preset `name`.

    Mappings are merged key by key. Any other value replaces the old one. null removes a key, so
    that its default applies. ``"*": null`` in a mapping removes all of its earlier keys, so that,
    for instance, all models are replaced. A mapping below ``"*"`` changes each of them. Raises
    InputError if the file or the preset is invalid, or there is no such preset.
    """
    preset = PRESETS / f"{name}.yaml"
    if not preset.is_file():
        known = ", ".join(sorted(path.stem for path in PRESETS.glob("*.yaml")))
        raise InputError(f"no preset {name!r}", PRESETS, f"Known: {known}")
    content = read_yaml(params)
    parse(Params, content, path=params)
    _apply_changes(content, read_yaml(preset))
    parse(Params, content, path=preset)
    return content


def _apply_changes(content: dict[str, Any], changes: dict[str, Any]) -> None:
    """Apply the changes of a preset to nested mappings."""
    if "*" in changes and changes["*"] is None:
        content.clear()
    elif "*" in changes:
        for entry in content.values():
            _apply_changes(entry, changes["*"])
    for key, value in changes.items():
        if key == "*":
            continue
        if value is None:
            content.pop(key, None)
        elif isinstance(value, dict) and isinstance(content.get(key), dict):
            _apply_changes(content[key], value)
        else:
            content[key] = value


def hash_imports(ingest: Ingest, raw: Path) -> str:
    """Return the hash of the files of imported drives but their images; empty without an import.

    timestamps.txt has a line per image, and import.json the names and sizes of the recordings.
    """
    hashes = {}
    for name in sorted({drive.partition("_drive_")[0] for drive in ingest.drives.splits()}):
        if (raw / name / IMPORT).is_file():
            for path in sorted((raw / name).rglob("*.*")):
                if path.suffix in (".json", ".csv", ".txt"):
                    hashes[path.relative_to(raw).as_posix()] = file_hash(path)
    return digest(hashes) if hashes else ""


def to_yaml(content: dict[str, Any], title: str) -> str:
    """Return content as YAML below a first line with a title."""
    stream = io.StringIO()
    YAML().dump(content, stream)
    return f"# {title}\n{stream.getvalue()}"


def write_run(run: Path, record: Mapping[str, Any], texts: Mapping[str, str]) -> None:
    """Write the code and the files `texts` of a run, in place of those of its last start.

    run.json has the `record` of the run and the hashes of these files. Raises InputError if one of
    them was edited since the last start, or if no run made the folder.
    """
    names = [*CODE, *texts]
    earlier = {}
    if (run / RUN).is_file():
        earlier = read_run(run)["files"]
    else:
        check_free(run)
    for path, sha256 in hash_files(run, names).items():
        # A run that was killed in this function has listed no files.
        if earlier and earlier.get(path) != sha256:
            fix = "Make the edits in the checkout or in the preset, then delete the file"
            raise InputError("was edited, and would be replaced", run / path, fix)

    write_json(run / RUN, {**record, "files": {}}, sort_keys=False)
    for name in names:
        remove_path(run / name)
    for path in hash_files(Path(), CODE):
        (run / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, run / path)
    for path, text in texts.items():
        write_text(run / path, text)
    write_json(run / RUN, {**record, "files": hash_files(run, names)}, sort_keys=False)


def hash_files(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return path → SHA-256 of the files `names`, and of those in the folders `names`."""
    hashes = {}
    for name in names:
        paths = [folder / name]
        if paths[0].is_dir():
            paths = list_files(paths[0])
        for path in paths:
            if path.is_file():
                hashes[path.relative_to(folder).as_posix()] = file_hash(path)
    return hashes


def run_dvc(run: Path, stages: list[str]) -> None:
    """Run stages in a run's folder. Raises Exit if DVC fails; its own messages say why."""
    commands = [
        # Hard links to the run's own cache save space on the disk.
        ["config", "cache.type", "hardlink,copy"],
        ["cache", "dir", ".dvc/cache"],
        ["repro", *stages],
    ]
    if not (run / ".dvc").is_dir():
        commands.insert(0, ["init", "--quiet", "--no-scm"])
    for command in commands:
        # At Ctrl-C, subprocess.run would kill DVC before it has ended its stage.
        if subprocess.Popen(["dvc", *command], cwd=run).wait():
            raise typer.Exit(1)


def publish_report(run: Path, report: Path, name: str) -> None:
    """Copy the page, the table and the results of a run to files NAME.*, and print the table."""
    source = run / "data/report"
    facts = describe_origin(run)
    results = json.loads((source / "results.json").read_text(encoding="utf-8"))
    # No file is replaced before all are written.
    with replacing(report / f"{name}.html") as page, replacing(report / f"{name}.md") as table:
        shutil.copyfile(source / "index.html", page)
        shutil.copyfile(source / "table.md", table)
        write_json(report / f"{name}.json", facts | {"results": results}, sort_keys=False)

    facts["time"] = f"{format_duration(read_run(run))} of the last make"
    print((source / "table.md").read_text(encoding="utf-8"))
    print(", ".join(f"{key} {value}" for key, value in facts.items()))
    print(f"Open data/report/{name}.html in a browser.")


if __name__ == "__main__":
    console.run(main)
