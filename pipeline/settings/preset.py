"""All sections of ``params.yaml`` as one type, and presets: sets of changes, ``presets/NAME.yaml``.

``python -m pipeline.settings.preset NAME`` writes a preset's changes into params.yaml and keeps its comments.
"""

import hashlib
import io
import re
import subprocess
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field

from pipeline.base import console
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import Name, Section, parse, read, read_yaml
from pipeline.base.resume import ROOT
from pipeline.base.store import replacing
from pipeline.settings.clouds import Clouds
from pipeline.settings.encoder import Encoder
from pipeline.settings.evaluate import Evaluate
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import Ingest
from pipeline.settings.labels import Labels
from pipeline.settings.models import Entry
from pipeline.settings.perception import Perception
from pipeline.settings.sample import Sample
from pipeline.settings.train import Train

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"
_ALL = "*"
_HEAD = re.compile(r"# Includes the changes of (.*), written by make params \(([0-9a-f]{16})\)\n")


class Params(Section):
    """All of params.yaml."""

    sample: Sample
    ingest: Ingest
    labels: Labels
    encoder: Encoder
    perception: Perception
    clouds: Clouds
    graphs: Annotated[dict[Name, Variant], Field(min_length=1)]
    models: Annotated[dict[Name, Entry], Field(min_length=1)]
    train: Train
    evaluate: Evaluate


def validate(content: dict[str, Any], where: Path) -> Params:
    """Return the content of a complete params file as :class:`Params`. Raises InputError, which names `where`."""
    with error_context(where):
        return parse(Params, content, "")


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    out: Annotated[Path, typer.Option(help="the file to write")] = Path("params.yaml"),
    params: Annotated[Path, typer.Option(help="the file that the preset changes")] = Path("params.yaml"),
) -> None:
    """Apply a preset. Raises InputError if `out` is no params file, or has edits that git and this function lack."""
    result = text(name, params)
    if out.exists():
        content = read(out)
        if content.keys() != Params.model_fields.keys():
            raise InputError("expected a params file to replace", out, "Pass another path")
        if _is_modified(out) and not _presets_in(out.read_text(encoding="utf-8")):
            raise InputError("has edits that are not committed", out, f"Commit them, or undo: git checkout {out}")
    with replacing(out) as path:
        path.write_text(result, encoding="utf-8")
    print(f"wrote {out}: {_short(params)} with the changes of {_short(find(name))}")


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of a complete `params` file with the changes of preset `name`, of presets/ or a path.

    Mappings are merged key by key; any other value replaces the old one. null removes a key, so its default applies,
    and ``"*": null`` removes all earlier keys, so that a list of models is replaced. Raises InputError.
    """
    preset = find(name)
    content, changes = read(params), read(preset)
    validate(content, _short(params))
    _merge(content, changes)
    validate(content, _short(preset))
    return content


def text(name: str, params: Path = PARAMS) -> str:
    """Return :func:`merged` as YAML; its first line names the presets and has a hash of the other lines."""
    from ruamel.yaml import YAML

    writer, stream = YAML(), io.StringIO()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    merged(name, params)  # raises
    document = read_yaml(params, comments=True)
    _merge(document, read(find(name)))
    writer.dump(document, stream)
    written = _HEAD.sub("", stream.getvalue(), count=1)
    presets = dict.fromkeys([*_presets_in(params.read_text(encoding="utf-8")), str(_short(find(name)))])
    return f"# Includes the changes of {', '.join(presets)}, written by make params ({_hash(written)})\n{written}"


def find(name: str) -> Path:
    """Return the file of preset `name`, which may be a path. Raises InputError if it does not exist."""
    path = Path(name) if "/" in name or name.endswith((".yaml", ".yml")) else PRESETS / f"{name}.yaml"
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml")))
        raise InputError("there is no such preset", name, f"Choose one of {names}")
    return path


def _merge(content: Any, changes: dict[str, Any]) -> None:
    """Apply changes to nested mappings, which may have comments; equal values keep their comments and style."""
    if changes.get(_ALL, 0) is None:
        content.clear()
    for key, value in changes.items():
        if value is None:
            content.pop(key, None)
        elif isinstance(value, dict) and isinstance(content.get(key), dict):
            _merge(content[key], value)
        elif key not in content or content[key] != value:
            content[key] = value


def _presets_in(written: str) -> list[str]:
    """Return the presets that the first line of a file of :func:`text` names; none if it was edited since."""
    head = _HEAD.match(written)
    return head[1].split(", ") if head and head[2] == _hash(written[head.end() :]) else []


def _hash(written: str) -> str:
    return hashlib.sha256(written.encode()).hexdigest()[:16]


def _is_modified(path: Path) -> bool:
    """Return whether git tracks `path` and its content is not committed."""
    command = ["git", "status", "--porcelain", "--untracked-files=no", "--", path.name]
    return bool(subprocess.run(command, cwd=path.absolute().parent, capture_output=True, check=False).stdout)


def _short(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


if __name__ == "__main__":
    console.run(main)
