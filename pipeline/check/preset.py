"""Merge presets, which are sets of changes to ``params.yaml``, or apply a preset to the file."""

import hashlib
import io
import shutil
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.params import parse, read_yaml
from pipeline.base.resume import ROOT
from pipeline.base.store import replacing, write_text
from pipeline.check.settings import Params

# Folder of the presets.
PRESETS = ROOT / "presets"
# File to which presets are applied.
PARAMS = ROOT / "params.yaml"
# Names that no preset may have: the other targets of the Makefile.
TARGETS = (
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
)
# Start of the first line of a stamped file.
_STAMP = "# Written by "
# Author of stamped files that this command writes; the name of the preset follows.
_AUTHOR = "make params"
# Author of stamped files that steer import writes.
IMPORT = "steer import"


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    folder: Annotated[Path, typer.Argument(help="where to write params.yaml")] = Path(),
) -> None:
    """Write params.yaml with the changes of a preset, and keep the file as params.yaml.before.

    Raises InputError if the file was edited since it was written, or written by another preset.
    """
    params = Path("params.yaml")
    out = folder / params
    author = f"{_AUTHOR} PRESET={name}"
    if out.exists() and out.samefile(params):
        apply(name, params, author)
        return

    # make encoder writes the settings of an encoder to another folder. It starts from the user's
    # own file, even if a preset has been applied to params.yaml since.
    base = params
    if author_of(params).startswith(_AUTHOR) and path_before(params).is_file():
        base = path_before(params)
    write(merged(name, base), out, author)


def apply(name: str, params: Path, author: str) -> None:
    """Apply the changes of preset `name` to the file `params`, and keep the user's own file."""
    content = merged(name, base_of(name, params))
    if not author_of(params):
        keep_before(params)
    write_text(params, to_yaml(content, author))
    before = path_before(params)
    print(f"wrote {params} with the changes of preset {name}; the file before is {before}")


def path_before(params: Path) -> Path:
    """Return the path of the file that ``make params`` replaced."""
    return params.with_name(f"{params.name}.before")


def keep_before(params: Path) -> None:
    """Keep `params`, which a preset will replace.

    Raises InputError if another file is kept already.
    """
    kept = path_before(params)
    if kept.exists() and kept.read_bytes() != params.read_bytes():
        problem = "holds other settings, which this command would replace"
        raise InputError(problem, kept, "Move or delete it")
    with replacing(kept) as unfinished:
        shutil.copyfile(params, unfinished)


def base_of(name: str, params: Path) -> Path:
    """Return the file to which a preset applies: `params`, or the file before it.

    If ``make params`` has already applied this preset to `params`, the file before that is
    returned. Raises InputError if another preset wrote `params`, if `params` was edited since, or
    if a run wrote it.
    """
    author = author_of(params)
    before = path_before(params)
    if not author:
        return params
    if author == f"{_AUTHOR} PRESET={name}" and is_unedited(params):
        if before.is_file():
            return before
        # A clone lacks the file before. Applying the preset to params.yaml again changes nothing.
        return params

    problem = f"{author} wrote it"
    if not is_unedited(params):
        problem += ", and it was edited since"
    problem += f", so preset {name} does not apply to it"
    way_back = f"mv {before} {params}"
    if not before.is_file():
        restore = f"git checkout COMMIT {params} restores one"
        way_back = f"git log {params} names earlier versions, {restore}"
    raise InputError(problem, params, f"Run it as it is: dvc repro. Or go back: {way_back}")


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of file `params` with its comments, and with the changes of a preset.

    `name` is a name in presets/, or a path. Mappings are merged key by key. Any other value
    replaces the old one. null removes a key, so that its default applies. ``"*": null`` in a
    mapping removes all of its earlier keys, so that, for instance, all models are replaced. Raises
    InputError if the file or the preset is invalid.
    """
    preset = path_of(name)
    content = read_yaml(params, comments=True)
    parse(Params, content, path=params)
    _merge(content, read_yaml(preset))
    parse(Params, content, path=preset)
    return content


def path_of(name: str) -> Path:
    """Return the file of a preset: `name` is a name in presets/, or a path.

    Raises InputError if there is none.
    """
    preset = PRESETS / f"{name}.yaml"
    if "/" in name or name.endswith((".yaml", ".yml")):
        preset = Path(name)
    if preset.is_file():
        return preset
    names = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml")))
    raise InputError("there is no such preset", name, f"Choose one of {names}")


def to_yaml(content: dict[str, Any], author: str) -> str:
    """Return content with comments as YAML that is :func:`stamped`."""
    stream = io.StringIO()
    writer = YAML()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    writer.dump(content, stream)
    dumped = stream.getvalue()
    # The comments begin with the stamp of the file to which the changes were applied.
    if dumped.startswith(_STAMP):
        dumped = dumped.partition("\n")[2]
    return stamped(dumped, author)


def write(content: dict[str, Any], out: Path, author: str) -> None:
    """Write a params file. Raises InputError if it would replace a file that was edited."""
    if out.exists() and not is_unedited(out):
        fix = "Move the edits to the preset, then delete the file"
        raise InputError("was edited, and would be replaced", out, fix)
    write_text(out, to_yaml(content, author))


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


def stamped(content: str, author: str) -> str:
    """Return the content of a file below a line with its author and its hash."""
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f"{_STAMP}{author}; SHA-256 of the other lines: {digest}\n{content}"


def author_of(path: Path) -> str:
    """Return the author of a :func:`stamped` file, even if it was edited, or an empty text."""
    if not path.exists():
        return ""
    first = path.read_text("utf-8", errors="replace").partition("\n")[0]
    if not first.startswith(_STAMP):
        return ""
    return first.removeprefix(_STAMP).partition(";")[0]


def is_unedited(path: Path) -> bool:
    """Return whether a file is as :func:`stamped` returned it."""
    first, _, content = path.read_text("utf-8", errors="replace").partition("\n")
    return first.endswith(f" {hashlib.sha256(content.encode()).hexdigest()}")


def check_name_is_free(name: str) -> None:
    """Raise InputError if a preset's name is another target of make, or a file in data/report."""
    if name in TARGETS:
        raise InputError("is a target of make", name, "Choose another name")
    outs = read_yaml(ROOT / "dvc.yaml")["stages"]["report"]["outs"]
    # The page of the run would replace that file, and its hard link in DVC's cache. Case is
    # ignored, as some disks ignore it.
    if name.lower() in {Path(out).stem for out in outs}:
        problem = "is the name of a file that stage report writes"
        raise InputError(problem, name, "Choose another name")


if __name__ == "__main__":
    console.run(main)
