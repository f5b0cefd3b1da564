"""Cache keys: reuse a finished result only if code, packages, settings and inputs match.

A key (:func:`stage_key`) hashes

- the bytes of the files that dvc.yaml lists for the stage; of networks and datasets those that the
  result uses (:class:`Code`)
- the versions of the packages in NUMERIC
- settings: the stage's section, and the drive's name
- inputs: the bytes of files, or strings such as a fingerprint of files

So results are made again after the edit of a comment. A key has no hidden files, number of
processes, path or machine, and nothing of this folder (JOBS).
"""

import importlib.metadata
import socket
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.base.hashes import digest, file_hash, list_files
from pipeline.base.params import read_yaml

# Packages whose files are code of stages.
PACKAGES = ("pipeline", "models", "stages")
# Folder of code that only runs stages and prints. It can change no number and no file's content, so
# dvc.yaml lists it for stage check alone, and no key has it.
JOBS = "pipeline/jobs/"
# Installed packages whose versions can change numbers, or the bytes of files.
NUMERIC = (
    "av",
    "h5py",
    "hdf5plugin",
    "numpy",
    "open3d",
    "opencv-python-headless",
    "pandas",
    "scipy",
    "torch",
    "torch-geometric",
    "transformers",
)
# Advice after an edit while a stage ran.
UNDO = (
    "Undo the edit and repeat the command: finished work is taken in seconds. With the edit, it "
    "is made again"
)


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


def scan_code() -> dict[str, str]:
    """Return the SHA-256 of each file of code, by its path below ROOT, and versions of NUMERIC."""
    found = {}
    for package in PACKAGES:
        for path in list_files(ROOT / package):
            found[path.relative_to(ROOT).as_posix()] = file_hash(path)
    for package in NUMERIC:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


# Code and packages as this process loads them: each stage imports this module before other packages
# of the project (isort's sections in pyproject.toml).
LOADED = scan_code()


class Code(NamedTuple):
    """Code and packages of a stage, as its process loaded them."""

    stage: str
    # File → SHA-256, and package → version.
    loaded: Mapping[str, str]
    # File of JOBS → SHA-256. It is compared with that of workers, and is in no key.
    jobs: Mapping[str, str]

    @classmethod
    def read(cls, stage: str, chosen: Collection[str] = ()) -> "Code":
        """Return the code that dvc.yaml lists for a stage.

        `chosen` are the files of the networks or datasets that the settings name. Other modules in
        their folders do not belong to the code, unless dvc.yaml lists the module itself.
        """
        jobs = {name: value for name, value in LOADED.items() if name.startswith(JOBS)}
        return cls(stage, _select_code(LOADED, stage, chosen), jobs)

    def hash(self) -> str:
        """Return a hash of the code."""
        return digest(self.loaded)

    def check_unedited(self, now: Mapping[str, str]) -> None:
        """Raise InputError if a file or a package was changed since the stage loaded it.

        `now` is a later :func:`scan_code`.
        """
        for name, value in self.loaded.items():
            if now.get(name) != value:
                raise InputError(f"was edited while stage {self.stage} ran", name, UNDO)

    def check_worker(self) -> None:
        """Raise InputError if this process, a cluster's worker, loaded other code or packages."""
        for name, value in {**self.loaded, **self.jobs}.items():
            loaded = LOADED.get(name, "none")
            if loaded != value:
                raise InputError(
                    f"differs from that of stage {self.stage} "
                    f"(got {loaded:.12}, expected {value:.12})",
                    f"{name} of the worker on {socket.gethostname()}",
                    "Undo the edit, or update the worker and start it again",
                )


def _select_code(loaded: Mapping[str, str], stage: str, chosen: Collection[str]) -> dict[str, str]:
    """Return what belongs to a stage.

    A chosen module has the files with its name, mine.py and mine.yaml, and the folder mine; also
    those in the folder `weights` beside its own.
    """
    deps = _dvc_entry(stage)["deps"]
    listed = tuple(f"{dep}/" for dep in deps)
    own: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    for path in map(Path, chosen):
        for folder in (path.parent, path.parent.with_name("weights")):
            own += (f"{folder}/{path.stem}.", f"{folder}/{path.stem}/")
            folders += (f"{folder}/",)

    selected = {}
    for name, value in loaded.items():
        is_alternative = name.startswith(folders)
        is_listed = name in NUMERIC or name.startswith(listed)
        if name in deps or name.startswith(own) or (is_listed and not is_alternative):
            selected[name] = value
    return selected


def read_sections(stage: str, params: Path | None, entry: str) -> dict[str, Any]:
    """Return the settings that dvc.yaml lists for a stage: dotted key → content.

    `entry` is the variant or model of the stage, or empty for a stage without entries.
    """
    sections = dict[str, Any]()
    if not params:
        return sections
    for listed_key in _dvc_entry(stage).get("params", []):
        key = listed_key.replace("${key}", entry)
        content: Any = read_yaml(params)
        for name in key.split("."):
            content = content.get(name, {})
        sections[key] = content
    return sections


def _dvc_entry(stage: str) -> dict[str, Any]:
    """Return what dvc.yaml says about a stage. In a stage with entries, it is below ``do``."""
    entry = read_yaml(ROOT / "dvc.yaml")["stages"][stage]
    return entry.get("do", entry)
