"""Cache keys: reuse results of an interrupted run only if code, settings and inputs match."""

import ast
import hashlib
import json
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.params import read

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("pipeline", "models", "stages")
CODE = (*PACKAGES, "dvc.yaml", ".dvcignore", "data/.gitignore")  # what a run needs of the checkout, without settings
# Of base/, what cannot change the bytes of a result: an edit of these files makes nothing again.
MACHINERY = {
    ROOT / f"pipeline/base/{name}.py" for name in ("console", "earlier", "executors", "outputs", "resume", "runner")
}

# Files that Windows writes to a folder while it is looked at.
DESKTOP = ("thumbs.db", "desktop.ini")


def stage_key(stage: str, settings: Mapping[str, Any], inputs: Sequence[Path | str], code: tuple[str, ...] = ()) -> str:
    """Return a key of the code that dvc.yaml names for the stage, of JSON-able settings, and of files or strings.

    `code`: files whose imports count instead of the code in dvc.yaml.
    """
    items = [item if isinstance(item, str) else file_hash(item) for item in inputs]
    return digest([settings, _import_hash(code) if code else _stage_code_hash(stage), items])[:32]


def digest(content: Any) -> str:
    """Return the SHA-256 of JSON-able content as hex."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as hex. Raises InputError if it is missing."""
    if not path.is_file():
        raise InputError("file is missing", path, "Make it: dvc repro. Or fetch it from another machine: dvc pull")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or one of the names and contents of a folder's files.

    Files that a file manager wrote do not count.
    """
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file() and not is_of_desktop(file)]
        return digest({file.name: file_hash(file) for file in files})
    return file_hash(path)


def is_of_desktop(path: Path) -> bool:
    """Return whether a file manager wrote the file: hidden files of macOS and Linux, and two of Windows."""
    return path.name.startswith(".") or path.name.lower() in DESKTOP


@cache
def _stage_code_hash(stage: str) -> str:
    """Hash the :func:`meaning` of the code that the stage's entry in dvc.yaml names; of ``${…}``, all alternatives."""
    entry = read(ROOT / "dvc.yaml")["stages"][stage]
    patterns = [re.sub(r"\$\{.*?\}", "*", path) for path in entry.get("do", entry)["deps"] if path.startswith(PACKAGES)]
    paths = [path for pattern in patterns for path in ROOT.glob(pattern)]
    files = {file for path in paths for file in (path.rglob("*.py") if path.is_dir() else [path])}
    return digest({str(file.relative_to(ROOT)): meaning(file) for file in files - MACHINERY})


@cache
def _import_hash(code: tuple[str, ...]) -> str:
    """Hash the :func:`meaning` of files of the project and of all that they import, directly or not."""
    files = [ROOT / path for path in code]
    for file in files:  # the list grows by the imports of each file
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                package = file.relative_to(ROOT).parts[: -node.level] if node.level else ()
                module = ".".join([*package, *filter(None, [node.module])])
                modules = [module, *(f"{module}.{alias.name}" for alias in node.names)]
            paths = [ROOT / f"{name.replace('.', '/')}.py" for name in modules if name.startswith(PACKAGES)]
            files += [path for path in paths if path.is_file() and path not in files]
    return digest({str(file.relative_to(ROOT)): meaning(file) for file in {*files} - MACHINERY})


@cache
def code_hash() -> str:
    """Return a hash of all code, cached at the first call."""
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    return digest({str(file.relative_to(ROOT)): file_hash(file) for file in files})


def revision(checkout: Path = Path()) -> str:
    """Return the short hash of the commit, with "-dirty" if code or settings differ from it; empty without git.

    A preset that git does not know, such as one by steer import, does not count: the page of its run shows it.
    """
    if not shutil.which("git") or not (checkout / ".git").exists():
        return ""
    git = partial(subprocess.run, cwd=checkout, capture_output=True, text=True, check=False)
    commit = git(["git", "rev-parse", "--short", "HEAD"]).stdout.strip()
    status = git(["git", "status", "--porcelain", "--", *CODE, "presets", "params.yaml"]).stdout.splitlines()
    changed = [line for line in status if not line.startswith("?? presets/")]
    return commit + "-dirty" * bool(changed)


def meaning(path: Path) -> str:
    """Return the code of a module from its syntax tree, without docstrings and comments."""
    try:
        tree = ast.parse(text := path.read_text(encoding="utf-8"))
    except SyntaxError:  # a network that is being written; others can be trained
        return text
    return ast.unparse(_WithoutDocstrings().visit(tree))  # ast.dump differs more between versions of Python


class _WithoutDocstrings(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node
