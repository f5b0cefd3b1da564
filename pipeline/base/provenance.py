"""Which source files a module's behaviour depends on: used for resume keys and to check dvc.yaml."""

import ast
import hashlib
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("pipeline", "models", "stages")


def import_closure(module: str) -> list[Path]:
    """Return the project's source files that `module` (dotted name) imports, directly or not, itself included.

    Imports inside functions count. Paths are relative to the repository root, sorted.
    """
    seen: dict[str, Path] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        path = _source(name)
        if name in seen or path is None:
            continue
        seen[name] = path
        todo += _imports(path)
    return sorted({path.relative_to(ROOT) for path in seen.values()})


@cache
def fingerprint(module: str) -> str:
    """Return a hash of the contents of :func:`import_closure` of `module`."""
    digest = hashlib.sha256()
    for path in import_closure(module):
        digest.update(str(path).encode() + b"\0" + (ROOT / path).read_bytes() + b"\0")
    return digest.hexdigest()


def revision() -> str:
    """Return git's name of the commit that is checked out, with "-dirty" if files differ; "unknown" outside of git."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _source(name: str) -> Path | None:
    if name.split(".")[0] not in PACKAGES:
        return None
    base = ROOT.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def _imports(path: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # ``from pipeline import store`` names a module, ``from pipeline.store import open_drive`` a function.
            names += [node.module] + [f"{node.module}.{alias.name}" for alias in node.names]
    return names
