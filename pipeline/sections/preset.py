"""Presets: ``presets/NAME.yaml`` holds what a run changes in ``params.yaml``, and nothing else.

``python -m pipeline.sections.preset NAME`` prints params.yaml with a preset's changes; ``--out params.yaml`` writes
them over it. Comments stay, and the result stands as DVC would write it, so that ``dvc exp run -S`` changes one line.
"""

import io
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
import yaml
from pydantic import Field, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from pipeline.base import console, yaml_file
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import NAME, Section, fault, parse, without_none
from pipeline.base.resume import ROOT
from pipeline.sections.clouds import Clouds
from pipeline.sections.encoder import Encoder
from pipeline.sections.evaluate import Evaluate
from pipeline.sections.graphs import Variant
from pipeline.sections.ingest import Ingest
from pipeline.sections.labels import Labels
from pipeline.sections.models import Model, resolve
from pipeline.sections.motion import Motion
from pipeline.sections.perception import Perception
from pipeline.sections.pictures import Pictures
from pipeline.sections.town import Town
from pipeline.sections.train import Train

PRESETS = ROOT / "presets"
PARAMS = ROOT / "params.yaml"
_WIDTH = 80  # where DVC's writer breaks a line of {…}
Name = Annotated[str, Field(pattern=f"^{NAME.pattern}$")]
_OVER = " is laid over params.yaml:"


class Params(Section):
    """All of params.yaml."""

    town: Town
    ingest: Ingest
    labels: Labels
    encoder: Encoder
    perception: Perception
    motion: Motion
    clouds: Clouds
    pictures: Pictures
    graphs: Annotated[dict[Name, Variant], Field(min_length=1)]
    models: Annotated[dict[Name, Model], Field(min_length=1)]
    train: Train
    evaluate: Evaluate


def main(
    name: Annotated[str, typer.Argument(metavar="PRESET", help="a name in presets/, or a file")],
    out: Annotated[Path | None, typer.Option(help="write to this file, and not to the terminal")] = None,
    params: Annotated[Path, typer.Option(help="what the preset changes")] = Path("params.yaml"),
) -> Path | None:
    """Lay a preset over params.yaml. Return the path that was written."""
    result = text(name, params)
    if out is None:
        print(result, end="")
        return None
    with replacing(out) as path:
        path.write_text(result, encoding="utf-8")
    heads = [line for line in result.splitlines() if line.startswith("# ") and _OVER in line]
    print("\n".join([f"{out} is written:", *heads]))
    return out


def merged(name: str, params: Path = PARAMS) -> dict[str, Any]:
    """Return the content of `params` with the changes of preset `name`. Raises InputError as :func:`text` does."""
    content: dict[str, Any] = yaml.safe_load(text(name, params))
    return content


def text(name: str, params: Path = PARAMS) -> str:
    """Return the file `params`, comments included, with the changes of preset `name`, which a head comment names.

    Mappings are merged key by key, anything else replaces what was there. null takes a key out, so that its default
    holds; a knob that has no default becomes null.

    Args:
        name: of a file in presets/, or the path of one elsewhere.
        params: a whole params file.

    Raises:
        InputError: there is no such preset, or a key or value of either file is wrong: names file and line.
    """
    source = find(name)
    changes, base, content = _read(source), _read(params), _read(params)
    _merge(content, changes, Params)
    result = _dump(content)
    files = {source: changes, params: base}
    try:
        whole = parse(Params, yaml_file.parse(result, _shown(source)), "")
    except InputError as error:
        cause = error.__cause__
        place = fault(cause)["loc"] if isinstance(cause, ValidationError) else ()
        raise InputError(f"{_culprit(place, files)}: {error}") from error
    for model, settings in whole.models.items():
        try:
            resolve(settings)  # the knobs of its networks
        except InputError as error:
            place = ("models", model, *str(error).split(maxsplit=1)[0].strip(":").split("."))
            raise InputError(f"{_culprit(place, files)}: models.{model}.{error}") from error
    about = source.read_text(encoding="utf-8").partition("\n")[0]
    head = f"# {_shown(source)}{_OVER}{about.removeprefix('#') if about.startswith('#') else ''}\n"
    return result if head in result else head + result


def find(name: str) -> Path:
    """Return the file of preset `name`, which may be its path. Raises InputError if there is none."""
    path = Path(name) if "/" in name or name.endswith((".yaml", ".yml")) else PRESETS / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml"))) or "none"
        raise InputError(
            f"there is no preset {name!r}: choose one of {_shown(PRESETS)}/ ({known}), or give a file's path"
        )
    return path


def _merge(base: CommentedMap, changes: CommentedMap, kind: Any, depth: int = 0) -> None:
    """Lay `changes` over `base`, both of type `kind`: a section, a mapping of sections, or None for anything else."""
    for key, value in changes.items():
        optional, inner = _schema(kind, key)
        if isinstance(value, CommentedMap):
            if not isinstance(base.get(key), CommentedMap):
                base[key] = _like(value)
            _merge(base[key], value, inner, depth + 1)
            base[key] = base[key] or CommentedMap()  # comments of what is gone would stand where {} belongs
            _break(base[key], key, depth)
        elif value is None and optional and (key in base or get_origin(kind) is not dict):
            base.pop(key, None)
        else:
            base[key] = _plain(value)


def _schema(kind: Any, key: str) -> tuple[bool, Any]:
    """Say of `key` in a mapping of type `kind`: may null take it out, and of what type is it. None: any."""
    if get_origin(kind) is dict:
        return True, get_args(kind)[1]
    if not (isinstance(kind, type) and issubclass(kind, Section)):
        return True, None
    field = kind.model_fields.get(key)
    if field is None:
        return kind.model_config.get("extra") == "allow", None
    return not field.is_required(), without_none(field.annotation)


def _plain(value: Any) -> Any:
    """Return a value without comments and with lists as DVC writes them: a line for each item, but inside of {…}."""
    if isinstance(value, CommentedMap):
        copy = _like(value)
        copy.update({key: _plain(item) for key, item in value.items()})
        return copy
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _like(value: CommentedMap) -> CommentedMap:
    """Return an empty mapping that is written as `value` is: as {…} or a line for each key."""
    copy = CommentedMap()
    if value.fa.flow_style():
        copy.fa.set_flow_style()
    return copy


def _break(value: CommentedMap, key: str, depth: int) -> None:
    """Give each key of `value` a line if {…}, so deep in the file, is too long for one line of DVC's writer."""
    if value.fa.flow_style() and _dump({key: _plain(value)}, _WIDTH - 2 * depth).count("\n") > 1:
        value.fa.set_block_style()
        value.update({key: _plain(item) for key, item in value.items()})


def _read(path: Path) -> CommentedMap:
    if not path.is_file():
        raise InputError(f"{path} is missing: run from the repository's root, or: git checkout {path.name}")
    try:
        text = yaml_file.read_text(path)
        yaml_file.parse(text, _shown(path))  # ruamel keeps tags and what else params.yaml cannot hold
        content = YAML().load(text)
    except MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{_shown(path)}{line} is not valid YAML: {error.problem}") from error
    except (YAMLError, ValueError) as error:
        raise InputError(f"{_shown(path)} is not valid YAML: {error}") from error
    if not isinstance(content, CommentedMap):
        raise InputError(f"{_shown(path)} holds no sections")
    return content


def _dump(content: Any, width: int = _WIDTH) -> str:
    writer, stream = YAML(), io.StringIO()
    writer.default_flow_style = False  # with these, as dvc.utils.serialize does
    writer.width = width
    writer.dump(content, stream)
    return stream.getvalue()


def _culprit(place: tuple[str | int, ...], files: dict[Path, CommentedMap]) -> str:
    """Return as FILE:LINE where the faulty key `place` stands: in the file that has the most of its path."""
    lines = {path: _line(content, place) for path, content in files.items()}
    path = max(lines, key=lambda path: lines[path][0])
    return f"{_shown(path)}:{lines[path][1]}"


def _line(content: Any, place: tuple[str | int, ...]) -> tuple[int, int]:
    """Return how many of the keys and indices `place` lead into `content`, and the line of the last that does."""
    depth, line = 0, 1
    for part in place:
        if isinstance(content, CommentedMap) and part in content:
            line = content.lc.key(part)[0] + 1
        elif isinstance(content, list) and isinstance(part, int) and part < len(content):
            line = content.lc.item(part)[0] + 1  # type: ignore[attr-defined]
        else:
            break
        content, depth = content[part], depth + 1
    return depth, line


def _shown(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


if __name__ == "__main__":
    console.run(main)
