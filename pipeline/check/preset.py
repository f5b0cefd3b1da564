"""Presets, which are sets of changes to ``params.yaml``, and the command that applies a preset to
the file.
"""

import hashlib
import io
import shutil
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.base import console, earlier
from pipeline.base.errors import InputError
from pipeline.base.params import parse, read_yaml
from pipeline.base.resume import ROOT, content_hash
from pipeline.base.store import replacing, write_text
from pipeline.check.recording_logs import check_recording_logs
from pipeline.check.settings import Params
from pipeline.ingest.datasets.recording import MOTION, WHEEL
from pipeline.ingest.settings import Part

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"
# Targets of the Makefile that are no presets, and presets that are none of its general target.
TARGETS = (
    *(
        "demo",
        "help",
        "encoder",
        "street",
        "udacity",
        "params",
        "test",
        "bench",
        "lint",
        "format",
        "setup",
        "system",
    ),
    *earlier.PRESETS,
)
# Authors of files, see stamped.
_AUTHOR = "make params"
IMPORT = "steer import"
_STAMP = "# Written by "


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    folder: Annotated[Path, typer.Argument(help="where to write params.yaml")] = Path(),
) -> None:
    """Write params.yaml with the changes of a preset, and keep the file before it as
    params.yaml.before.

    Raises InputError if the file was edited since it was written, or written by another preset.
    """
    params = Path("params.yaml")
    out = folder / params
    author = f"{_AUTHOR} PRESET={name}"
    # make street and make encoder: settings of one encoder
    if not (out.exists() and out.samefile(params)):
        is_of_preset = author_of(params).startswith(_AUTHOR) and before(params).is_file()
        write(merged(name, before(params) if is_of_preset else params), out, author)
        return
    base = base_of(name, params)
    content = merged(name, base)
    take_logs(content, Path("data/raw"))
    if not author_of(params):
        keep_before(params)
    write_text(params, text(content, author))
    print(f"wrote {params} with the changes of preset {name}; the file before is {before(params)}")


def before(params: Path) -> Path:
    """Return the path of the file that ``make params`` replaced."""
    return params.with_name(f"{params.name}.before")


def keep_before(params: Path) -> None:
    """Keep `params`, which a preset will replace. Raises InputError if another file is kept
    already.
    """
    kept = before(params)
    if kept.exists() and kept.read_bytes() != params.read_bytes():
        raise InputError(
            "holds other settings, which this command would replace", kept, "Move or delete it"
        )
    with replacing(kept) as new:
        shutil.copyfile(params, new)


def base_of(name: str, params: Path) -> Path:
    """Return the file to which a preset applies: `params`, or what it was before ``make params``
    with this preset.

    Raises InputError if another preset wrote `params`, if `params` was edited since, or if a run
    wrote it.
    """
    author = author_of(params)
    if not author:
        return params
    if author == f"{_AUTHOR} PRESET={name}" and is_unedited(params):
        # A clone has params.yaml alone: the preset once more changes nothing there.
        return before(params) if before(params).is_file() else params
    problem = f"{author} wrote it, so preset {name} does not apply to it"
    if not is_unedited(params):
        problem = (
            f"{author} wrote it, and it was edited since, so preset {name} does not apply to it"
        )
    way_back = f"mv {before(params)} {params}"
    if not before(params).is_file():
        way_back = (
            f"git log {params} names earlier versions, git checkout COMMIT {params} restores one"
        )
    raise InputError(problem, params, f"Run it as it is: dvc repro. Or go back: {way_back}")


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return a complete `params` file with the changes of preset `name`, of presets/ or a path, and
    with its comments.

    Mappings are merged key by key; any other value replaces the old one. null removes a key, so its
    default applies, and ``"*": null`` removes all earlier keys, so that a list of models is
    replaced. Raises InputError.
    """
    preset = path_of(name)
    content = read_yaml(params, comments=True)
    parse(Params, content, path=params)
    _merge(content, read_yaml(preset))
    parse(Params, content, path=preset)
    return content


def path_of(name: str) -> Path:
    """Return the file of a preset, of presets/ or a path. Raises InputError if there is none."""
    preset = (
        Path(name) if "/" in name or name.endswith((".yaml", ".yml")) else PRESETS / f"{name}.yaml"
    )
    if not preset.is_file():
        if preset.stem in earlier.PRESETS:
            fix = (
                f"Its question is closed, see docs/log.md. git switch --detach {earlier.LAST} "
                "runs it"
            )
            raise InputError("is a preset of an earlier version", name, fix)
        names = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml")))
        raise InputError("there is no such preset", name, f"Choose one of {names}")
    return preset


def take_logs(content: dict[str, Any], raw: Path) -> None:
    """Replace the hashes of logs below `raw` that were edited since their import; missing files
    keep theirs.

    Raises InputError for images that were not imported, and for a log that an import would refuse.
    """
    folders: dict[str, list[Any]] = {}
    for part in content["ingest"].get("recordings", {}).values():
        folders.setdefault(part["folder"], []).append(part)
    for name, parts in folders.items():
        edited = find_edited(raw / name, parts[0]["files"])
        if not edited:
            continue
        print(
            f"edited since steer import: {', '.join(str(raw / name / file) for file in edited)}",
            flush=True,
        )
        if all((raw / name / file).exists() for file in parts[0]["files"]):
            # All parts at once: from the first start to the last end.
            ends = [part.get("end") for part in parts]
            whole = dict(parts[0])
            whole["start"] = min(part.get("start", 0.0) for part in parts)
            whole["end"] = None if None in ends else max(ends)
            check_recording_logs(Part(**whole), raw / name)
        # Without the images, only drives that were made or fetched with this log can be used.
        for part in parts:
            part["files"].update(edited)


def find_edited(folder: Path, files: dict[str, str]) -> dict[str, str]:
    """Return the logs of a recording that have another hash than in `files`, with their new hashes.

    Raises InputError for other images or times of images.
    """
    edited = {}
    for name, expected in files.items():
        path = folder / name
        found = content_hash(path) if path.exists() else expected
        if found == expected:
            continue
        if name not in (WHEEL, MOTION):
            problem = (
                "is not what was imported: lens, horizon and parts of the preset may not fit it"
            )
            raise InputError(problem, path, "Repeat steer import")
        edited[name] = found
    return edited


def text(content: dict[str, Any], author: str) -> str:
    """Return content with comments as YAML, :func:`stamped`."""
    writer, stream = YAML(), io.StringIO()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    writer.dump(content, stream)
    dumped = stream.getvalue()
    if dumped.startswith(_STAMP):  # of the file to which the changes were applied
        dumped = dumped.partition("\n")[2]
    return stamped(dumped, author)


def write(content: dict[str, Any], out: Path, author: str) -> None:
    """Write a params file. Raises InputError if there is one that is not as an earlier call wrote
    it.
    """
    if out.exists() and not is_unedited(out):
        raise InputError(
            "was edited, and would be replaced",
            out,
            "Move the edits to the preset, then delete the file",
        )
    write_text(out, text(content, author))


def _merge(content: dict[str, Any], changes: dict[str, Any]) -> None:
    """Apply changes to nested mappings, which may have comments; equal values keep their comments
    and style.
    """
    if changes.get("*", 0) is None:
        content.clear()
    for key, value in changes.items():
        if value is None:
            content.pop(key, None)
        elif isinstance(value, dict) and isinstance(content.get(key), dict):
            _merge(content[key], value)
        elif key not in content or content[key] != value:
            content[key] = value


def stamped(content: str, author: str) -> str:
    """Return the content of a file below a line with its author and its hash, for
    :func:`is_unedited`.
    """
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f"{_STAMP}{author}; SHA-256 of the other lines: {digest}\n{content}"


def author_of(path: Path) -> str:
    """Return the author of a file that :func:`stamped` returned, also of an edited one; empty for
    other files.
    """
    first = path.read_text("utf-8", errors="replace").partition("\n")[0] if path.exists() else ""
    return first.removeprefix(_STAMP).partition(";")[0] if first.startswith(_STAMP) else ""


def is_unedited(path: Path) -> bool:
    """Return whether a file is as :func:`stamped` returned it."""
    first, _, rest = path.read_text("utf-8", errors="replace").partition("\n")
    return first.endswith(f" {hashlib.sha256(rest.encode()).hexdigest()}")


def check_name_is_free(name: str) -> None:
    """Raise InputError for the name of a preset that is another target of make, or that of a file
    in data/report.
    """
    if name in TARGETS:
        raise InputError("is a target of make", name, "Choose another name")
    outs = read_yaml(ROOT / "dvc.yaml")["stages"]["report"]["outs"]
    # The page of the run would replace it, in DVC's cache, too; also on a disk that ignores case.
    if name.lower() in {Path(out).stem for out in outs}:
        raise InputError(
            "is the name of a file that stage report writes", name, "Choose another name"
        )


if __name__ == "__main__":
    console.run(main)
