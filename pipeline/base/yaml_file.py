"""YAML that people write: read without running anything, and refused where it says one thing twice or grows as it is
read (aliases of aliases)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from pipeline.base.errors import InputError
from pipeline.base.files import MiB, read_bytes

_MOST_NODES = 100_000  # with each alias written out; params.yaml has 400
_DEEPEST = 30
_LONGEST = 1_000  # characters of a word or number


def read(path: Path) -> Any:
    """Return what a YAML file holds.

    Raises InputError, with the line where there is one, if it is not UTF-8, not YAML, holds tags or a key twice, or is
    out of all proportion.
    """
    return parse(read_text(path), path)


def parse(text: str, path: Path) -> Any:
    """Return what a text holds, which :func:`read_text` read, or what was made of it; an error names `path`."""
    with _explained(path):
        return yaml.safe_load(text)


def read_text(path: Path) -> str:
    """Return the text of a YAML file that :func:`read` lets pass but for its values; raises as it does."""
    with _explained(path):
        text = read_bytes(path, MiB).decode("utf-8-sig")
        _check(yaml.compose(text, yaml.SafeLoader), path)
    return text


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except yaml.MarkedYAMLError as error:
        raise _fault(path, error.problem_mark, str(error.problem)) from error
    except RecursionError as error:
        raise _fault(path, None, "nested too deep") from error
    except (yaml.YAMLError, ValueError) as error:  # a number or date that there is not, text that is not UTF-8
        raise _fault(path, None, str(error)) from error


def _fault(path: Path, mark: yaml.Mark | None, what: str) -> InputError:
    return InputError(f"{path}{f':{mark.line + 1}' if mark else ''} is not valid YAML: {what}")


def _check(root: yaml.Node | None, path: Path) -> None:
    """Walk all nodes as they would be constructed. Raises InputError."""
    todo: list[tuple[yaml.Node, int]] = [(root, 0)] if root else []
    count = 0
    while todo:
        node, depth = todo.pop()
        count += 1
        if count > _MOST_NODES or depth > _DEEPEST:
            raise _fault(path, node.start_mark, "too much of it, or nested too deep, once its aliases are written out")
        if isinstance(node, yaml.ScalarNode) and len(node.value) > _LONGEST:
            raise _fault(path, node.start_mark, f"a value of {len(node.value)} characters")
        if isinstance(node, yaml.SequenceNode):
            todo += [(item, depth + 1) for item in node.value]
        elif isinstance(node, yaml.MappingNode):
            _check_keys(node, path)
            todo += [(part, depth + 1) for pair in node.value for part in pair]


def _check_keys(node: yaml.MappingNode, path: Path) -> None:
    names: set[tuple[str, str]] = set()
    for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
        if (key.tag, key.value) in names:
            raise _fault(path, key.start_mark, f"duplicate key {key.value}")
        names.add((key.tag, key.value))
