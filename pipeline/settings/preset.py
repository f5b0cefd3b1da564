"""All sections of ``params.yaml`` as one type, and presets: sets of changes, ``presets/NAME.yaml``.

``python -m pipeline.settings.preset NAME`` prints params.yaml with a preset's changes; ``--out params.yaml`` overwrites
the file and keeps its comments.
"""

import io
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field

from pipeline.base import console
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.files import read_yaml
from pipeline.base.params import Name, Section, parse, read
from pipeline.base.resume import ROOT
from pipeline.settings.clouds import Clouds
from pipeline.settings.encoder import Encoder
from pipeline.settings.evaluate import Evaluate
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import Ingest
from pipeline.settings.labels import Labels
from pipeline.settings.models import Entry
from pipeline.settings.motion import Motion
from pipeline.settings.perception import Perception
from pipeline.settings.sample import Sample
from pipeline.settings.train import Train

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"
_ALL = "*"


class Params(Section):
    """All of params.yaml."""

    sample: Sample
    ingest: Ingest
    labels: Labels
    encoder: Encoder
    perception: Perception
    motion: Motion
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
    out: Annotated[Path | None, typer.Option(help="write to this file instead of the terminal")] = None,
    params: Annotated[Path, typer.Option(help="the file that the preset changes")] = Path("params.yaml"),
) -> Path | None:
    """Apply a preset to params.yaml. Return the path of the written file."""
    result = text(name, params)
    if out is None:
        print(result, end="")
        return None
    content = read_yaml(out) if out.is_file() else None
    if out.is_file() and not (isinstance(content, dict) and content.keys() == Params.model_fields.keys()):
        raise InputError("expected a params file to replace", out, "Pass another path")
    with replacing(out) as path:
        path.write_text(result, encoding="utf-8")
    print(f"wrote {out}: {_short(params)} with the changes of {_short(find(name))}")
    return out


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of `params` with the changes of preset `name`.

    Mappings are merged key by key; any other value replaces the old one. null removes a key, so its default applies,
    and ``"*": null`` removes all earlier keys, so that a list of models is replaced.

    Args:
        name: of a file in presets/, or the path of another file.
        params: a complete params file.

    Raises InputError if there is no such preset, or if a key or value of either file is wrong.
    """
    content, changes = read(params), read(find(name))
    validate(content, _short(params))
    _merge(content, changes)
    validate(content, _short(find(name)))
    return content


def text(name: str, params: Path = PARAMS) -> str:
    """Return :func:`merged` as YAML with the comments of `params`, and a first line that names the preset."""
    from ruamel.yaml import YAML

    merged(name, params)  # raises
    writer, stream = YAML(), io.StringIO()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    document = read_yaml(params, comments=True)
    _merge(document, read(find(name)))
    writer.dump(document, stream)
    head = f"# Includes the changes of {_short(find(name))}\n"
    return stream.getvalue() if head in stream.getvalue() else head + stream.getvalue()


def find(name: str) -> Path:
    """Return the file of preset `name`, which may be a path. Raises InputError if it does not exist."""
    path = Path(name) if "/" in name or name.endswith((".yaml", ".yml")) else PRESETS / f"{name}.yaml"
    with error_context(fix=f"Choose one of {', '.join(sorted(file.stem for file in PRESETS.glob('*.yaml')))}"):
        if not path.is_file():
            raise InputError("there is no such preset", name)
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


def _short(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


if __name__ == "__main__":
    console.run(main)
