"""Cache keys: reuse a finished result only if code, packages, settings and inputs match.

A key hashes what can change the bytes of a result (:func:`stage_key`):

- the code that dvc.yaml lists for the stage, by its meaning, and its data files (:class:`Code`)
- versions of the installed packages that this code imports, except for TOOLS
- settings: the stage's section, and the drive's name
- inputs: the bytes of files, or strings such as a fingerprint of files

A key leaves out what cannot change them: comments, docstrings and layout of the code, modules of
networks and datasets that the result does not use, the number of processes, paths and the machine.
"""

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
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.base.errors import InputError
from pipeline.base.params import read_yaml

ROOT = Path(__file__).resolve().parents[2]
# Packages whose files are code of stages.
PACKAGES = ("pipeline", "models", "stages")
# Files and folders of the checkout, other than settings, that a run in runs/NAME needs.
CODE = (*PACKAGES, "dvc.yaml", ".dvcignore", "data/.gitignore")
# Modules whose versions do not change results, as they serve command lines, settings, locks,
# progress bars, memory, downloads and pages.
TOOLS = {
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
# Module → name of the package that installs it, if the names differ.
DISTRIBUTIONS = {"cv2": "opencv-python-headless"}
# Advice after an edit while a stage ran.
UNDO = (
    "Undo the edit and repeat the command: finished work is taken in seconds. With the edit, it "
    "is made again"
)
# Ends of the names of files that Python and editors leave beside code.
LEFTOVERS = (".pyc", ".pyo", "~")
# Files that Windows writes to a folder that a user opens.
WINDOWS_FILES = ("thumbs.db", "desktop.ini")
# Stamp of a missing file, in place of its time and size.
MISSING = (0, 0)


def stage_key(code: str, settings: Mapping[str, Any], inputs: Sequence[Path | str]) -> str:
    """Return the cache key of a result: 32 hexadecimal digits.

    `code` is :meth:`Code.hash`, `settings` are JSON-able, `inputs` are files or strings.
    """
    items = []
    for item in inputs:
        if isinstance(item, Path):
            item = file_hash(item)
        items.append(item)
    return digest([settings, code, items])[:32]


def digest(content: Any) -> str:
    """Return the SHA-256 of JSON-able content as hex."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as hex. Raises InputError if it is missing."""
    if not path.is_file():
        fix = "Make it: dvc repro. Or fetch it from another machine: dvc pull"
        raise InputError("file is missing", path, fix)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of the files in a folder.

    Files that a file manager wrote to the folder do not count.
    """
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file()]
        return digest({file.name: file_hash(file) for file in files if not is_by_desktop(file)})
    return file_hash(path)


def is_by_desktop(path: Path) -> bool:
    """Return whether a file manager wrote the file: a hidden file, or one of WINDOWS_FILES."""
    return path.name.startswith(".") or path.name.lower() in WINDOWS_FILES


class Module(NamedTuple):
    """What cache keys take from a file of code, or from a data file beside code."""

    # Hash of the code without docstrings and comments. For a data file, the hash of its bytes.
    meaning: str
    # Names of imported modules. "from a import b" gives a and a.b, as b may be a module.
    names: frozenset[str]


@cache
def parse_module(file: Path, content: bytes) -> Module:
    """Return the meaning and the imports of a file's content; `file` is relative to ROOT."""
    tree = None
    if file.suffix == ".py":
        # A user's unfinished network may have syntax errors. Other networks can still be trained.
        with suppress(SyntaxError, ValueError):
            tree = ast.parse(content)
    if tree is None:
        return Module(hashlib.sha256(content).hexdigest(), frozenset())

    names = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            module = _imported_from(node, file)
            names.add(module)
            names.update(f"{module}.{alias.name}" for alias in node.names)

    # ast.unparse differs less between versions of Python than ast.dump.
    code = ast.unparse(_WithoutDocstrings().visit(tree))
    return Module(hashlib.sha256(code.encode()).hexdigest(), frozenset(names))


def _imported_from(node: ast.ImportFrom, file: Path) -> str:
    """Return the full name of the module from which a file imports, also for "from .a import b"."""
    names = [node.module] if node.module else []
    if node.level:
        names = [*file.parts[: -node.level], *names]
    return ".".join(names)


class _WithoutDocstrings(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return None
        return node


def find_imports(file: Path) -> set[Path]:
    """Return the files of the project that a file imports; paths are relative to ROOT."""
    paths = set[Path]()
    for name in parse_module(file, (ROOT / file).read_bytes()).names:
        module = Path(*name.split("."))
        paths.add(module.with_suffix(".py"))
        # Python runs the __init__.py of all packages around a module.
        paths.update(folder / "__init__.py" for folder in (module, *module.parents))
    return {path for path in paths if (ROOT / path).is_file()}


def with_imports(files: Iterable[Path]) -> set[Path]:
    """Return files, and all files of the project that they import, directly or not.

    Paths are relative to ROOT.
    """
    result = set[Path]()
    queue = [file for file in files if (ROOT / file).is_file()]
    while queue:
        file = queue.pop()
        if file not in result:
            result.add(file)
            queue += find_imports(file)
    return result


def listed_code(stage: str, chosen: Collection[str] = ()) -> set[Path]:
    """Return the files of code that dvc.yaml lists for a stage, relative to ROOT.

    A path with ``${…}`` in dvc.yaml stands for files that depend on the settings. It lists the
    files in `chosen` that match it.
    """
    files = set[Path]()
    for dep in _dvc_entry(stage)["deps"]:
        if "${" in dep:
            pattern = re.sub(r"\$\{.*?\}", "*", dep)
            for path in fnmatch.filter(chosen, pattern):
                files |= _code_files(ROOT / path)
        elif dep.startswith(PACKAGES):
            files |= _code_files(ROOT / dep)
    return files


def _dvc_entry(stage: str) -> dict[str, Any]:
    """Return what dvc.yaml says about a stage. In a stage with entries, it is below ``do``."""
    entry = read_yaml(ROOT / "dvc.yaml")["stages"][stage]
    return entry.get("do", entry)


def _code_files(path: Path) -> set[Path]:
    """Return a file, or the files of a folder, relative to ROOT, without leftovers."""
    files = set[Path]()
    for file in (path, *path.rglob("*")):
        if is_by_desktop(file) or file.name.endswith(LEFTOVERS):
            continue
        if file.is_file():
            files.add(file.relative_to(ROOT))
    return files


def _stamp(path: Path) -> tuple[int, int]:
    """Return the time of the last change of a file in ns, and its size; or MISSING."""
    if not path.is_file():
        return MISSING
    stat = path.stat()
    return stat.st_mtime_ns, stat.st_size


# File of code → its stamp before this process loads it: each stage imports pipeline/base before
# other packages of the project.
_LOADED = {
    file: _stamp(ROOT / file) for package in PACKAGES for file in _code_files(ROOT / package)
}


@dataclass(frozen=True)
class Code:
    """The code of a stage as it was when the stage began. Paths of files are relative to ROOT."""

    stage: str
    content: Mapping[Path, bytes]
    stamps: Mapping[Path, tuple[int, int]]

    @classmethod
    def read(cls, stage: str, chosen: Collection[str] = ()) -> "Code":
        """Read the code that dvc.yaml lists for a stage.

        Each network and each dataset is a file. `chosen` are the networks or datasets that the
        settings name. The others do not belong to the code. Raises InputError if this process may
        have loaded other code.
        """
        files = _without_alternatives(listed_code(stage, chosen), chosen)
        content = {file: (ROOT / file).read_bytes() for file in files}
        # Stamps are taken after the content was read, so that an edit in between is detected.
        stamps = {file: _stamp(ROOT / file) for file in files}
        code = cls(stage, content, stamps)
        code.check_unedited()
        return code

    @cached_property
    def modules(self) -> dict[Path, Module]:
        """Meaning and imports of each file."""
        return {file: parse_module(file, content) for file, content in self.content.items()}

    def __getstate__(self) -> dict[str, Any]:
        # A worker compares meanings, so it needs no content.
        return self.__dict__ | {"modules": self.modules, "content": {}}

    def hash(self, chosen: Collection[str] = ()) -> str:
        """Return the hash of the code's meaning, and of versions of the packages that it imports.

        `chosen` are the networks or datasets that count, among those passed to :meth:`read`.
        """
        meanings = dict[str, str]()
        imported = set[str]()
        for file in _without_alternatives({*self.content}, chosen):
            module = self.modules[file]
            meanings[str(file)] = module.meaning
            imported.update(name.partition(".")[0] for name in module.names)

        packages = [name for name in imported - TOOLS if _is_installed(name)]
        versions = {name: _version(name) for name in packages}
        return digest([meanings, versions])

    def check_unedited(self) -> None:
        """Raise InputError if code was edited since this process started.

        Its meaning must be the same as loaded by this process, when the stage began, and now on
        disk.
        """
        for file, stamp in self.stamps.items():
            now = _stamp(ROOT / file)
            loaded = _LOADED.get(file, now)
            if stamp == loaded == now:
                continue

            # The file was written again. Its content is known at two times: when the stage began,
            # and now. The file counts as unedited if both contents have the same meaning, and this
            # process loaded one of the two.
            content = b""
            if now != MISSING:
                content = (ROOT / file).read_bytes()
            same_meaning = parse_module(file, content).meaning == self.modules[file].meaning
            was_compared = loaded in (stamp, now)
            if not same_meaning or not was_compared:
                raise InputError(f"was edited while stage {self.stage} ran", file, UNDO)

    def read_sections(self, params: Path | None, entry: str) -> dict[str, Any]:
        """Return the settings that dvc.yaml lists for the stage: dotted key → content.

        `entry` is the variant or model of the stage, or empty for a stage without entries.
        """
        sections = dict[str, Any]()
        if not params:
            return sections
        for listed_key in _dvc_entry(self.stage).get("params", []):
            key = listed_key.replace("${key}", entry)
            content: Any = read_yaml(params)
            for name in key.split("."):
                content = content.get(name, {})
            sections[key] = content
        return sections


def _without_alternatives(files: set[Path], chosen: Iterable[str]) -> set[Path]:
    """Return files without the alternatives to the `chosen` ones: other modules in their folders.

    Modules that a chosen file imports stay, and so do data files.
    """
    chosen_files = {Path(path) for path in chosen}
    folders = {path.parent for path in chosen_files}
    modules = {file for file in files if file.suffix == ".py" and file.parent in folders}
    alternatives = modules - chosen_files
    if alternatives:
        alternatives -= with_imports(chosen_files)
    return files - alternatives


def _is_installed(module: str) -> bool:
    """Return whether a module is of an installed package, not of Python or of the project."""
    if module in sys.stdlib_module_names:
        return False
    if (ROOT / module).exists() or (ROOT / f"{module}.py").exists():
        return False
    return importlib.util.find_spec(module) is not None


@cache
def _version(module: str) -> str:
    """Return the version of the package that installs a module, or an empty text."""
    try:
        return importlib.metadata.version(DISTRIBUTIONS.get(module, module))
    except importlib.metadata.PackageNotFoundError:
        # This search is slow, so DISTRIBUTIONS has the frequent names.
        names = importlib.metadata.packages_distributions().get(module, [])
        return " ".join(importlib.metadata.version(name) for name in names)


def revision(checkout: Path = Path()) -> str:
    """Return the short hash of the commit, with "-dirty" if code or settings differ from it.

    It is empty if git is not installed, or `checkout` is not a repository.
    """
    if not shutil.which("git") or not (checkout / ".git").exists():
        return ""
    commit = _git(checkout, "rev-parse", "--short", "HEAD").strip()
    status = _git(checkout, "status", "--porcelain", "--", *CODE, "presets", "params.yaml")
    for line in status.splitlines():
        # A new preset, such as one by steer import, does not count: the page of its run shows it.
        if not line.startswith("?? presets/"):
            return f"{commit}-dirty"
    return commit


def _git(checkout: Path, *arguments: str) -> str:
    """Return the output of git in a checkout; empty if it fails."""
    command = ["git", *arguments]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)
    return done.stdout
