"""Cache keys: reuse results of an interrupted run only if code, settings and inputs match."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.base.params import read

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("pipeline", "models", "stages")


def stage_key(stage: str, settings: Mapping[str, Any], inputs: Sequence[Path | str]) -> str:
    """Return a hash of the code that dvc.yaml names for the stage, of JSON-able settings, and of files or strings."""
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode() + _stage_code_hash(stage).encode())
    for item in inputs:
        digest.update((item if isinstance(item, str) else file_hash(item)).encode() + b"\0")
    return digest.hexdigest()[:32]


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file as hex. Raises InputError if it is missing."""
    if not path.is_file():
        raise InputError("file is missing", path, "Make it: dvc repro. Or fetch it from another machine: dvc pull")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@cache
def _stage_code_hash(stage: str) -> str:
    """Hash the code that the stage's entry in dvc.yaml names; of ``${…}``, all alternatives."""
    entry = read(ROOT / "dvc.yaml")["stages"][stage]
    dependencies = entry.get("do", entry)["deps"]
    patterns = [re.sub(r"\$\{.*?\}", "*", path) for path in dependencies if path.startswith(PACKAGES)]
    return _hash_code(path for pattern in patterns for path in ROOT.glob(pattern))


@cache
def code_hash() -> str:
    """Return a hash of all code, cached at the first call."""
    return _hash_code(ROOT / package for package in PACKAGES)


def _hash_code(paths: Iterable[Path]) -> str:
    files = {file for path in paths for file in (path.rglob("*.py") if path.is_dir() else [path])}
    lines = [f"{file.relative_to(ROOT)} {file_hash(file)}\n" for file in sorted(files)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()
