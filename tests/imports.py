"""Which source files a module imports."""

import ast
from collections.abc import Iterator
from pathlib import Path

from pipeline.base.resume import PACKAGES, ROOT


def import_closure(*modules: str) -> list[Path]:
    """Return the project's source files that `modules` (dotted names) import, directly or not, themselves included.

    Imports inside functions count, and so do the ``__init__.py`` of the packages on the way. Imports under
    ``if TYPE_CHECKING:`` do not: they never run. What is imported by a computed name is not seen: give that module too.
    Paths are relative to the repository root, sorted.
    """
    paths: dict[str, Path] = {}
    todo = list(modules)
    while todo:
        name = todo.pop()
        path = _source(name)
        if name in paths or path is None:
            continue
        paths[name] = path
        package, _, _ = name.rpartition(".")
        todo += [package, *_imports(path, name if path.name == "__init__.py" else package)]
    return sorted({path.relative_to(ROOT) for path in paths.values()})


def _source(name: str) -> Path | None:
    if name.split(".")[0] not in PACKAGES:
        return None
    base = ROOT.joinpath(*name.split("."))
    for path in (base / "__init__.py", base.with_suffix(".py")):  # Python's order, should both be there
        if path.is_file():
            return path
    return None


def _imports(path: Path, package: str) -> list[str]:
    """Return dotted names that the file imports; some may be functions, which have no source file of their own."""
    names: list[str] = []
    for node in _nodes_that_run(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: -(node.level - 1) or None] if node.level else []
            module = ".".join([*parents, *([node.module] if node.module else [])])
            # ``from pipeline.base import store`` names a module, ``from pipeline.base.store import SCHEMA`` a value.
            names += [module] + [f"{module}.{alias.name}" for alias in node.names]
    return names


def _nodes_that_run(tree: ast.AST) -> Iterator[ast.AST]:
    yield tree
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and ast.unparse(child.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            for other in child.orelse:
                yield from _nodes_that_run(other)
        else:
            yield from _nodes_that_run(child)
