"""Presets, sets of changes to ``params.yaml``, and the command that writes those of one into the file."""

import hashlib
import io
import subprocess
from pathlib import Path
from typing import Annotated, Any

import typer
from ruamel.yaml import YAML

from pipeline.base import console, earlier
from pipeline.base.errors import InputError
from pipeline.base.params import parse, read
from pipeline.base.resume import ROOT, content_hash
from pipeline.base.store import replacing
from pipeline.check.settings import Params

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"
# Targets of the Makefile that are no presets, and presets that are none of its general target.
TARGETS = (
    *("demo", "help", "encoder", "street", "udacity", "params", "test", "bench", "lint", "format", "setup", "system"),
    *earlier.PRESETS,
)
# Files that stage report writes: the page of a preset of this name would replace them in DVC's cache.
REPORT = ("index", "metrics", "results", "table")
_AUTHOR, IMPORT = "make params", "steer import"


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    folder: Annotated[Path, typer.Argument(help="where to write params.yaml")] = Path(),
) -> None:
    """Write params.yaml with the changes of a preset. Raises InputError if it was edited by hand since its commit."""
    merged(name, Path("params.yaml"))  # finds faults
    refresh(path_of(name), Path("data/raw"))
    result, out = text(name, Path("params.yaml")), folder / "params.yaml"
    status = ["git", "status", "--porcelain", "--untracked-files=no", out.name]
    if out.exists() and not is_unedited(out) and subprocess.run(status, cwd=folder, capture_output=True).stdout:
        raise InputError("has edits that are not committed", out, f"Commit them, or undo: git checkout {out}")
    with replacing(out) as path:
        path.write_text(result, encoding="utf-8")
    print(f"wrote {out}: params.yaml with the changes of preset {name}")


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return a complete `params` file with the changes of preset `name`, of presets/ or a path, and with its comments.

    Mappings are merged key by key; any other value replaces the old one. null removes a key, so its default applies,
    and ``"*": null`` removes all earlier keys, so that a list of models is replaced. Raises InputError.
    """
    preset = path_of(name)
    content = read(params, comments=True)
    parse(Params, content, path=params)
    _merge(content, read(preset))
    parse(Params, content, path=preset)
    return content


def path_of(name: str) -> Path:
    """Return the file of a preset, of presets/ or a path. Raises InputError if there is none."""
    preset = Path(name) if "/" in name or name.endswith((".yaml", ".yml")) else PRESETS / f"{name}.yaml"
    if not preset.is_file():
        if preset.stem in earlier.PRESETS:
            fix = f"Its question is closed, see docs/log.md. git switch --detach {earlier.LAST} runs it"
            raise InputError("is a preset of an earlier version", name, fix)
        names = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml")))
        raise InputError("there is no such preset", name, f"Choose one of {names}")
    return preset


def refresh(preset: Path, raw: Path) -> None:
    """Replace the hashes in a preset of recordings whose files below `raw` have changed; missing files keep theirs.

    With a changed copy, which an import must not replace, the preset counts as edited.
    """
    content, hashes, changed = read(preset, comments=True), dict[Path, str](), set[Path]()
    for part in filter(None, ((content.get("ingest") or {}).get("recordings") or {}).values()):
        for name, before in part.get("files", {}).items():
            path = raw / part.get("folder", "") / name
            if path.exists() and path not in hashes:
                hashes[path] = content_hash(path)
            if hashes.get(path, before) != before:
                part["files"][name] = hashes[path]
                changed.add(path)
    if changed:
        as_imported = is_unedited(preset) and all(path.is_symlink() for path in changed)
        with replacing(preset) as new:
            text = _dumped(content)
            new.write_text(stamped(text, IMPORT) if as_imported else text, encoding="utf-8")
        print(f"{preset}: new hash of {', '.join(map(str, sorted(changed)))}")


def text(name: str, params: Path = PARAMS) -> str:
    """Return :func:`merged` as YAML, :func:`stamped`."""
    return stamped(_dumped(merged(name, params)), _AUTHOR)


def _dumped(content: dict[str, Any]) -> str:
    """Return content with comments as YAML, without the line of :func:`stamped`."""
    writer, stream = YAML(), io.StringIO()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    writer.dump(content, stream)
    first, _, rest = stream.getvalue().partition("\n")
    return rest if first.startswith("# Written by ") else stream.getvalue()


def _merge(content: dict[str, Any], changes: dict[str, Any]) -> None:
    """Apply changes to nested mappings, which may have comments; equal values keep their comments and style."""
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
    """Return the content of a file below a line with its hash, for :func:`is_unedited`."""
    digest = hashlib.sha256(content.encode()).hexdigest()
    return f"# Written by {author}; SHA-256 of the other lines: {digest}\n{content}"


def is_unedited(path: Path) -> bool:
    """Return whether a file is as :func:`stamped` returned it."""
    first, _, rest = path.read_text("utf-8", errors="replace").partition("\n")
    return first.endswith(f" {hashlib.sha256(rest.encode()).hexdigest()}")


def check_name_is_free(name: str) -> None:
    """Raise InputError for the name of a preset that is another target of make, or that of a file in data/report."""
    if name in TARGETS:
        raise InputError("is a target of make", name, "Pass another --name")
    if name in REPORT:
        raise InputError("is the name of a file that stage report writes", name, "Pass another --name")


if __name__ == "__main__":
    console.run(main)
