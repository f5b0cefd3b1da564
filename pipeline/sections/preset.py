"""Presets: ``presets/NAME.yaml`` holds the values that a run changes in ``params.yaml``.

``python -m pipeline.sections.preset NAME`` prints params.yaml with a preset's changes; ``--out params.yaml`` overwrites
the file and keeps its comments.
"""

import io
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base import console
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, error_context
from pipeline.base.params import read
from pipeline.base.resume import ROOT
from pipeline.sections.params import validate

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"


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
    with replacing(out) as path:
        path.write_text(result, encoding="utf-8")
    print(f"wrote {out}: {_short(params)} with the changes of {_short(find(name))}")
    return out


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of `params` with the changes of preset `name`.

    Mappings are merged key by key; any other value replaces the old one. null removes a key, so its default applies.

    Args:
        name: of a file in presets/, or the path of another file.
        params: a complete params file.

    Raises InputError if there is no such preset, or if a key or value of either file is wrong.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    base, changes = read(params), read(find(name))
    validate(base, _short(params))
    try:
        content: Any = OmegaConf.to_container(OmegaConf.merge(base, changes))
    except OmegaConfBaseException as error:
        raise InputError(str(error), _short(find(name))) from error
    _remove_nulls(content, changes)
    validate(content, _short(find(name)))
    return dict(content)


def text(name: str, params: Path = PARAMS) -> str:
    """Return :func:`merged` as YAML with the comments of `params`, and a first line that names the preset."""
    from ruamel.yaml import YAML

    content, writer, stream = merged(name, params), YAML(), io.StringIO()
    writer.default_flow_style = False  # as DVC writes, so that `dvc exp run -S` changes one line
    document = writer.load(params.read_text(encoding="utf-8-sig"))
    _update(document, content)
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


def _remove_nulls(content: dict[str, Any], changes: dict[str, Any]) -> None:
    for key, value in changes.items():
        if value is None:
            del content[key]
        elif isinstance(value, dict):
            _remove_nulls(content[key], value)


def _update(document: Any, content: dict[str, Any]) -> None:
    """Make a commented mapping equal to `content`; unchanged values keep their comments and style."""
    for key in [key for key in document if key not in content]:
        del document[key]
    for key, value in content.items():
        if isinstance(value, dict) and isinstance(document.get(key), dict):
            _update(document[key], value)
        elif key not in document or document[key] != value:
            document[key] = value


def _short(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


if __name__ == "__main__":
    console.run(main)
