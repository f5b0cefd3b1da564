"""Weights of the unified encoder in a file: written, found, verified, read."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline import checkpoint
from pipeline.drives import file_hash
from pipeline.errors import InputError

SHA256 = re.compile(r"[0-9a-fA-F]{64}")


KIND = "unified encoder"


@dataclass(frozen=True)
class Weights:
    """A checkpoint: where it lay, the backbone it is for, and the network's tensors by name."""

    path: Path
    backbone: str
    state: Mapping[str, Any]


def write_weights(path: Path, backbone: str, state: Mapping[str, Any]) -> None:
    """Write a checkpoint in one step: tensors and plain values only."""
    import torch

    # Strides are part of the file: a clone forgets whether the network ran with channels last.
    tensors = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in state.items()
    }
    checkpoint.write(path, {"kind": KIND, "backbone": backbone, "net": tensors})


def find_weights(setting: str) -> tuple[Path, str]:
    """Return path and SHA-256 of what ``encoder.weights`` names, ``PATH`` or ``PATH#sha256=HEX``.

    Raises InputError if the file is missing or is another one than the hash says.
    """
    name, _, wanted = setting.partition("#sha256=")
    if wanted and not SHA256.fullmatch(wanted):
        raise InputError(
            f"encoder.weights = {setting}: a SHA-256 has 64 hexadecimal digits. sha256sum {name} prints it"
        )
    path = Path(name)
    if not path.is_file():
        raise InputError(
            f"encoder.weights: {name} is missing. Put the checkpoint there (data/encoder/encoder.pt of another run), "
            "or set weights: null to fit from the start"
        )
    found = file_hash(path)
    if wanted and found != wanted.lower():
        raise InputError(
            f"encoder.weights: {name} has the SHA-256 {found}, not {wanted.lower()}: it is damaged or another file. "
            "Get it again, or correct the hash"
        )
    return path, found


def read_weights(path: Path, mend: str) -> Weights:
    """Read a checkpoint of :func:`write_weights`; `mend` ends the messages: what to do if it is none.

    Raises InputError if it is missing, cut short or no checkpoint of a unified encoder.
    """
    content = checkpoint.read(path, KIND, mend)
    return Weights(path, str(content["backbone"]), content["net"])
