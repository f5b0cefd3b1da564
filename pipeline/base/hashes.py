"""Hash files, folders and settings."""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError

# Pattern of paths of files that Python, editors and file managers leave beside code.
LEFTOVERS = re.compile(r"/\.|/__pycache__/|~$")


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
    """Return the SHA-256 of a file, or of the names and contents of the files in a folder."""
    if path.is_dir():
        files = list_files(path)
        return digest({str(file.relative_to(path)): file_hash(file) for file in files})
    return file_hash(path)


def list_files(folder: Path) -> list[Path]:
    """Return all files below a folder, without leftovers."""
    files = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not LEFTOVERS.search(f"/{name}"):
            files.append(path)
    return files
