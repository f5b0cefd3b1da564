"""What a result is known by, so that an interrupted run goes on from what it finished and from nothing else."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.base import provenance
from pipeline.base.errors import InputError


def resume_key(module: str | Sequence[str], settings: Mapping[str, Any], inputs: Sequence[Path | str]) -> str:
    """Return a hash of all that determines a result: a module's code, parameters, input files.

    Args:
        module: dotted name; the code of all it imports counts. Several, where one is imported by a name in the params.
        settings: JSON-able.
        inputs: files, whose contents count, or strings that stand for some.
    """
    modules = [module] if isinstance(module, str) else module
    code = provenance.fingerprint(*modules)
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode() + code.encode())
    for item in inputs:
        digest.update((item if isinstance(item, str) else file_hash(item)).encode() + b"\0")
    return digest.hexdigest()[:32]


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file's contents, as hex. Raises InputError if it is missing."""
    if not path.is_file():
        raise InputError(f"{path} is missing: dvc repro makes it, dvc pull brings it from another machine")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
