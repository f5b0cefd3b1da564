"""``make NAME``: run presets/NAME.yaml in runs/NAME, a copy of the code with its own DVC cache.

This file is no stage. It merges settings, copies files and starts DVC.
"""

import hashlib
import io
import json
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.base import console
from pipeline.base.checkout import CHECKOUT, CODE, revision
from pipeline.base.errors import InputError, error_context
from pipeline.base.keys import ROOT, code_files, digest, file_hash
from pipeline.base.outputs import locked
from pipeline.base.params import check_name, parse, read_yaml
from pipeline.base.store import replacing, write_json, write_text
from pipeline.check.preset import PRESETS, check_name_is_free
from pipeline.check.settings import Params
from pipeline.encoder.settings import Encoder
from pipeline.encoder.weights import weights_hash
from pipeline.ingest.datasets.kitti import IMPORT
from pipeline.ingest.settings import Ingest
from pipeline.report.origin import RUN, duration, origin, read_run

# File of settings into which presets are merged.
PARAMS = ROOT / "params.yaml"
# Commands of DVC that a run executes. Hard links to the run's own cache save space on the disk.
DVC = ("config cache.type hardlink,copy", "cache dir .dvc/cache", "repro")


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/")],
    stages: Annotated[list[str] | None, typer.Argument(help="default: all")] = None,
) -> None:
    """Run stages with a preset. If all have run, copy the report to data/report/PRESET.*.

    Raises InputError if the preset is running already, or would replace other files.
    """
    stages = stages or []
    run = Path("runs") / name

    # All settings are checked before anything is written.
    with error_context(PRESETS / f"{name}.yaml"):
        check_name(name)
    if not stages:
        check_name_is_free(name)
    settings = merged(name, Path("params.yaml"))
    # DVC notices other weights under the same name by their hash in the settings.
    sha256 = weights_hash(parse(Encoder, settings["encoder"], "encoder"))
    if sha256:
        settings["encoder"]["weights_sha256"] = sha256
    # DVC does not watch data/raw. It notices another import of the same drives by this hash.
    sha256 = imports_hash(parse(Ingest, settings["ingest"], "ingest"), Path("data/raw"))
    if sha256:
        settings["ingest"]["imports_sha256"] = sha256

    run.parent.mkdir(exist_ok=True)
    with locked(run, f"{run}.lock"):
        record = {
            "preset": name,
            "revision": revision(Path.cwd()),
            "started_s": time.time(),
            "settings": read_yaml(PRESETS / f"{name}.yaml"),
        }
        files = {
            "params.yaml": to_yaml(settings, f"make {name}: params.yaml with presets/{name}.yaml"),
            str(CHECKOUT): str(Path.cwd()),
        }
        contents = {path: text.encode() for path, text in files.items()}
        write_run(run, record, contents | read_code())
        run_dvc(run, stages)
        if not stages:
            publish(run, Path("data/report"), name)
            print(f"Open data/report/{name}.html in a browser.")


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of file `params` with its comments, and with the changes of a preset.

    `name` is a name in presets/, or a path. Mappings are merged key by key. Any other value
    replaces the old one. null removes a key, so that its default applies. ``"*": null`` in a
    mapping removes all of its earlier keys, so that, for instance, all models are replaced. Raises
    InputError if the file or the preset is invalid.
    """
    preset = PRESETS / f"{name}.yaml"
    if Path(name).suffix == ".yaml":
        preset = Path(name)
    content = read_yaml(params, comments=True)
    parse(Params, content, path=params)
    _merge(content, read_yaml(preset))
    parse(Params, content, path=preset)
    return content


def imports_hash(ingest: Ingest, raw: Path) -> str:
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


def _merge(content: dict[str, Any], changes: dict[str, Any]) -> None:
    """Apply changes to nested mappings. Values that do not change keep their comments."""
    if changes.get("*", 0) is None:
        content.clear()
    for key, value in changes.items():
        if value is None:
            content.pop(key, None)
        elif isinstance(value, dict) and isinstance(content.get(key), dict):
            _merge(content[key], value)
        elif key not in content or content[key] != value:
            content[key] = value


def to_yaml(content: dict[str, Any], title: str) -> str:
    """Return content with comments as YAML below a first line with a title."""
    stream = io.StringIO()
    writer = YAML()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    writer.dump(content, stream)
    return f"# {title}\n{stream.getvalue()}"


def read_code() -> dict[str, bytes]:
    """Return the content of the files of code that a run needs, by their path."""
    contents = dict[str, bytes]()
    for name in CODE:
        paths = [Path(name)]
        if Path(name).is_dir():
            paths = code_files(Path(name))
        contents |= {path.as_posix(): path.read_bytes() for path in paths}
    return contents


def write_run(run: Path, record: Mapping[str, Any], contents: Mapping[str, bytes]) -> None:
    """Write the files of a run, and remove earlier ones that it no longer has.

    run.json has the `record` of the run and the hashes of its files. Raises InputError if a file
    was edited since the last run, or if no run made the folder.
    """
    written = {}
    pending = {}
    if (run / RUN).exists():
        written = read_run(run).get("files", {})
        # Hashes that a run wanted to write which was killed in this function.
        pending = read_run(run).get("pending", {})
    elif run.exists() and any(run.iterdir()):
        raise InputError("is a folder that no run made", run, "Move it away, or rename the preset")

    new = {path: hashlib.sha256(content).hexdigest() for path, content in contents.items()}
    paths = written | pending | new
    present = {path: file_hash(run / path) for path in paths if (run / path).is_file()}
    for path, sha256 in present.items():
        if sha256 not in (written.get(path), pending.get(path), new.get(path)):
            fix = "Make the edits in the checkout or in the preset, then delete the file"
            raise InputError("was edited, and would be replaced", run / path, fix)

    write_json(run / RUN, {**record, "files": written, "pending": new}, sort_keys=False)
    for path in present.keys() - new.keys():
        (run / path).unlink()
    for path, content in contents.items():
        if present.get(path) != new[path]:
            with replacing(run / path) as unfinished:
                unfinished.write_bytes(content)
    write_json(run / RUN, {**record, "files": new}, sort_keys=False)


def run_dvc(run: Path, stages: list[str]) -> None:
    """Run the commands of DVC. Raises Exit if one fails."""
    commands = [command.split() for command in DVC]
    if not (run / ".dvc").is_dir():
        commands.insert(0, ["init", "--quiet", "--no-scm"])
    commands[-1] += stages
    for words in commands:
        process = subprocess.Popen(["dvc", *words], cwd=run)
        while process.poll() is None:
            # Ctrl-C reaches DVC, too, which ends its stage and then itself.
            with suppress(KeyboardInterrupt):
                process.wait()
        if process.returncode:
            raise typer.Exit(1)


def publish(run: Path, report: Path, name: str) -> None:
    """Copy the page, the table and the results of a run to files NAME.*, and print the table."""
    results = json.loads((run / "data/report/results.json").read_text(encoding="utf-8"))
    run_origin = origin(run)
    write_json(report / f"{name}.json", run_origin | {"results": results}, sort_keys=False)
    for source, suffix in {"index.html": "html", "table.md": "md"}.items():
        text = (run / "data/report" / source).read_text(encoding="utf-8")
        write_text(report / f"{name}.{suffix}", text)
    facts = [f"{key} {value}" for key, value in run_origin.items()]
    facts.append(f"{duration(read_run(run))} of the last make")
    print(text, ", ".join(facts), sep="\n")


if __name__ == "__main__":
    console.run(main)
