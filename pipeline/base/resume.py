"""Cache keys: reuse a result only if code, packages, settings and inputs match."""

import ast
import fnmatch
import hashlib
import importlib.metadata
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.base.errors import InputError
from pipeline.base.params import read

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("pipeline", "models", "stages")
# what a run needs of the checkout, without settings
CODE = (*PACKAGES, "dvc.yaml", ".dvcignore", "data/.gitignore")
# Modules whose versions change no number: command lines, settings, locks, progress, memory,
# clusters, downloads, pages.
TOOLS = {
    "distributed",
    "filelock",
    "huggingface_hub",
    "jinja2",
    "markupsafe",
    "matplotlib",
    "plotly",
    "psutil",
    "pydantic",
    "ruamel",
    "tqdm",
    "typer",
}
# Distributions of modules with another name.
DISTRIBUTIONS = {"cv2": "opencv-python-headless"}
# What to do after an edit while a stage ran.
UNDO = (
    "Undo the edit and repeat the command: finished work is taken in seconds. With the edit, it "
    "is made again"
)
# Ends of the names of files that Python and editors leave beside code.
LEFT = (".pyc", ".pyo", "~")
# Files that Windows writes to a folder while it is looked at.
DESKTOP = ("thumbs.db", "desktop.ini")


def stage_key(code: str, settings: Mapping[str, Any], inputs: Sequence[Path | str]) -> str:
    """Return a key of :meth:`Code.hash`, of JSON-able settings, and of files or strings."""
    items = [item if isinstance(item, str) else file_hash(item) for item in inputs]
    return digest([settings, code, items])[:32]


def digest(content: Any) -> str:
    """Return the SHA-256 of JSON-able content as hex."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as hex. Raises InputError if it is missing."""
    if not path.is_file():
        raise InputError(
            "file is missing",
            path,
            "Make it: dvc repro. Or fetch it from another machine: dvc pull",
        )
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
    """Return whether a file manager wrote the file: hidden files of macOS and Linux, and two of
    Windows.
    """
    return path.name.startswith(".") or path.name.lower() in DESKTOP


class Module(NamedTuple):
    """What matters of a file's content."""

    # hash of its syntax tree, without docstrings and comments; of a data file, of its bytes
    meaning: str
    names: frozenset[str]  # of imported modules; of "from a import b", a and a.b


@cache
def parse_module(file: Path, content: bytes) -> Module:
    """Return what matters of the content of a file, whose path is relative to ROOT."""
    try:
        tree = ast.parse(content) if file.suffix == ".py" else None
    except (SyntaxError, ValueError):  # a network that is being written; others can be trained
        tree = None
    if tree is None:
        return Module(hashlib.sha256(content).hexdigest(), frozenset())
    names = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            package = file.parts[: -node.level] if node.level else ()
            module = ".".join([*package, *filter(None, [node.module])])
            names |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    # ast.dump differs more between versions of Python
    code = ast.unparse(_WithoutDocstrings().visit(tree))
    return Module(hashlib.sha256(code.encode()).hexdigest(), frozenset(names))


class _WithoutDocstrings(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return (
            None
            if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
            else node
        )


def imports(file: Path) -> set[Path]:
    """Return the files of the project that a file imports; paths are relative to ROOT."""
    result = set[Path]()
    for name in parse_module(file, (ROOT / file).read_bytes()).names:
        module = Path(*name.split("."))
        result |= {
            module.with_suffix(".py"),
            *(folder / "__init__.py" for folder in (module, *module.parents)),
        }
    return {path for path in result if (ROOT / path).is_file()}


def imported(files: Iterable[Path]) -> set[Path]:
    """Return files and all files of the project that they import, directly or not; paths are
    relative to ROOT.
    """
    result = set[Path]()
    queue = [file for file in files if (ROOT / file).is_file()]
    while queue:
        file = queue.pop()
        if file not in result:
            result.add(file)
            queue += imports(file)
    return result


def listed(stage: str, own: Collection[str] = ()) -> set[Path]:
    """Return the files of code that dvc.yaml lists for a stage, relative to ROOT; for ``${…}``,
    those in `own`.
    """
    files = set[Path]()
    for dep in _dvc_entry(stage)["deps"]:
        if "${" in dep:
            for path in fnmatch.filter(own, re.sub(r"\$\{.*?\}", "*", dep)):
                files |= _files(ROOT / path)
        elif dep.startswith(PACKAGES):
            files |= _files(ROOT / dep)
    return files


def _dvc_entry(stage: str) -> dict[str, Any]:
    entry = read(ROOT / "dvc.yaml")["stages"][stage]
    return entry.get("do", entry)


def _files(path: Path) -> set[Path]:
    """Return a file, or the files of a folder, relative to ROOT; not those that Python and editors
    leave.
    """
    files = [
        file for file in (path, *path.rglob("*")) if file.is_file() and not is_of_desktop(file)
    ]
    return {file.relative_to(ROOT) for file in files if not file.name.endswith(LEFT)}


def _stamp(path: Path) -> tuple[int, int]:
    """Return time and size of a file; of a missing one, zeros."""
    if not path.is_file():
        return 0, 0
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size


# Of each module, its stamp before this process loads it: stages import base/ before all other
# rooms.
_LOADED = {file: _stamp(ROOT / file) for package in PACKAGES for file in _files(ROOT / package)}


@dataclass(frozen=True)
class Code:
    """The code of a stage as it is at the start."""

    stage: str
    content: Mapping[Path, bytes]  # by path relative to ROOT
    stamps: Mapping[Path, tuple[int, int]]

    @classmethod
    def of(cls, stage: str, own: Collection[str] = ()) -> "Code":
        """Read the code that dvc.yaml lists for a stage. Raises InputError if this process may have
        loaded other code.

        `own`: of networks or datasets, which have a file each, those that the stage needs.
        """
        files = _without_alternatives(listed(stage, own), own)
        content = {file: (ROOT / file).read_bytes() for file in files}
        code = cls(stage, content, {file: _stamp(ROOT / file) for file in files})
        code.check()
        return code

    @cached_property
    def modules(self) -> dict[Path, Module]:
        return {file: parse_module(file, content) for file, content in self.content.items()}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"modules": self.modules, "content": {}}

    def hash(self, own: Collection[str] = ()) -> str:
        """Return the hash of the meaning of the code and of the versions of the packages that it
        imports.
        """
        modules = {
            str(file): self.modules[file] for file in _without_alternatives({*self.content}, own)
        }
        names = {name.partition(".")[0] for module in modules.values() for name in module.names}
        packages = {name: _version(name) for name in names - TOOLS if _is_installed(name)}
        return digest([{file: module.meaning for file, module in modules.items()}, packages])

    def check(self) -> None:
        """Raise InputError if the code on disk, or that this process loaded, has another meaning
        than at the start.
        """
        for file, stamp in self.stamps.items():
            now = _stamp(ROOT / file)
            loaded = _LOADED.get(file, now)
            if loaded == stamp == now:
                continue
            content = (ROOT / file).read_bytes() if now != (0, 0) else b""
            if (
                loaded in (stamp, now)
                and parse_module(file, content).meaning == self.modules[file].meaning
            ):
                continue
            raise InputError(f"was edited while stage {self.stage} ran", file, UNDO)

    def sections(self, params: Path | None, entry: str) -> dict[str, Any]:
        """Return what dvc.yaml lists of a params file for an entry of the stage: dotted key →
        content.
        """
        result = dict[str, Any]()
        if not params:
            return result
        for listed_key in _dvc_entry(self.stage).get("params", []):
            key = listed_key.replace("${key}", entry)
            content: Any = read(params)
            for name in key.split("."):
                content = content.get(name, {})
            result[key] = content
        return result


def _without_alternatives(files: set[Path], own: Iterable[str]) -> set[Path]:
    """Return files without the modules beside the files `own`, unless these import them; data files
    there stay.
    """
    needed = {Path(path) for path in own}
    folders = {path.parent for path in needed}
    alternatives = {
        file for file in files if file.suffix == ".py" and file.parent in folders
    } - needed
    if alternatives:
        alternatives -= imported(needed)
    return files - alternatives


def _is_installed(module: str) -> bool:
    """Return whether a module is of an installed package, not of Python or of the project."""
    if (
        module in sys.stdlib_module_names
        or (ROOT / module).exists()
        or (ROOT / f"{module}.py").exists()
    ):
        return False
    return importlib.util.find_spec(module) is not None


@cache
def _version(module: str) -> str:
    """Return the version of the package that has a module; empty without it."""
    try:
        return importlib.metadata.version(DISTRIBUTIONS.get(module, module))
    except importlib.metadata.PackageNotFoundError:
        names = importlib.metadata.packages_distributions().get(module, [])  # slow
        return " ".join(importlib.metadata.version(name) for name in names)


def revision(checkout: Path = Path()) -> str:
    """Return the short hash of the commit, with "-dirty" if code or settings differ from it; empty
    without git.

    A preset that git does not know, such as one by steer import, does not count: the page of its
    run shows it.
    """
    if not shutil.which("git") or not (checkout / ".git").exists():
        return ""
    git = partial(subprocess.run, cwd=checkout, capture_output=True, text=True, check=False)
    commit = git(["git", "rev-parse", "--short", "HEAD"]).stdout.strip()
    status = git(
        ["git", "status", "--porcelain", "--", *CODE, "presets", "params.yaml"]
    ).stdout.splitlines()
    changed = [line for line in status if not line.startswith("?? presets/")]
    return commit + "-dirty" * bool(changed)
