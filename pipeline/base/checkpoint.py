"""Write and read files of tensors.

A file is written in one step, read without running code, and loaded into a network only if all
tensors match.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

import torch

from pipeline.base.errors import InputError
from pipeline.base.store import replacing


def write(path: Path, content: Mapping[str, Any]) -> None:
    """Write tensors and plain values by name, in one step."""
    # Serialise to memory first. On a full disk, torch's own writer would raise a RuntimeError;
    # writing the bytes raises an OSError with the reason.
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with replacing(path) as tmp:
        tmp.write_bytes(buffer.getbuffer())


def read(path: Path, kind: str) -> dict[str, Any]:
    """Return the content of a file by :func:`write` whose ``content["kind"]`` is `kind`.

    Raises InputError if it is not. Callers add the fix.
    """
    content = load(path)
    if not isinstance(content, dict) or content.get("kind") != kind:
        raise InputError(f"expected a checkpoint of this project's {kind}", path)
    return content


def load(path: Path) -> Any:
    """Return the content of a file by torch.save, on the CPU.

    Raises InputError if it is missing, damaged or contains code. Such code does not run.
    """
    if not path.is_file():
        raise InputError("file is missing", path)
    try:
        return torch.load(path, weights_only=True, map_location="cpu")
    # For a damaged file, torch raises exceptions of various classes, for instance OSError and
    # UnpicklingError.
    except Exception as error:
        problem = "file is damaged, or has more than tensors and plain values"
        raise InputError(problem, path) from error


def load_state(module: torch.nn.Module, state: Mapping[str, Any], path: Path) -> None:
    """Copy tensors into a module.

    Raises InputError unless all names and shapes agree and all values are finite.
    """
    try:
        module.load_state_dict(state, strict=True)
    except (RuntimeError, TypeError) as error:
        difference = shorten(str(error).splitlines()[-1], 200)
        raise InputError(f"file does not match the network: {difference}", path) from error
    for name, tensor in state.items():
        if not tensor.isfinite().all():
            raise InputError(f"{name} has values that are not finite", path)
