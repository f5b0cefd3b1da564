"""Merge presets, which are sets of changes to ``params.yaml``, into its settings."""

import hashlib
import io
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.base import console
from pipeline.base.errors import InputError
from pipeline.base.params import parse, read_yaml
from pipeline.base.resume import ROOT
from pipeline.base.store import write_text
from pipeline.check.settings import Params

# Folder of the presets.
PRESETS = ROOT / "presets"
# File of settings into which presets are merged.
PARAMS = ROOT / "params.yaml"
# Names that no preset may have: the other targets of the Makefile.
TARGETS = (
    "demo",
    "help",
    "encoder",
    "street",
    "udacity",
    "test",
    "bench",
    "lint",
    "format",
    "setup",
    "system",
)
# Start of the first line of a stamped file.
_STAMP = "# Written by "
# Author of stamped files that steer import writes.
IMPORT = "steer import"


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    folder: Annotated[Path, typer.Argument(help="where to write params.yaml")],
) -> None:
    """Write params.yaml, with the changes of a preset, to a folder.

    Raises InputError if the file was edited since it was written.
    """
    write(merged(name, Path("params.yaml")), folder / "params.yaml", f"make {name}")


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
