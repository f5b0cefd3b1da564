"""Weights of the unified encoder: this project's checkpoints, and the files that others publish for its parts."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.encoder.download import find
from pipeline.fitting import checkpoint

KIND = "unified encoder"
Setting = str | Mapping[str, str] | None
"""A checkpoint of this project, or a published file for each of some parts, or nothing."""
WRAPPERS = ("state_dict", "model")  # what published files call their tensors, where they hold more than these


@dataclass(frozen=True)
class Weights:
    """A checkpoint: where it lay, the backbone it is for, and the network's tensors by name."""

    path: Path
    backbone: str
    state: Mapping[str, Any]


@dataclass(frozen=True)
class Source:
    """A file that weights came from, as found, and the part of the encoder it filled; "all" for a whole checkpoint."""

    part: str
    path: str
    sha256: str


def write_weights(path: Path, backbone: str, state: Mapping[str, Any]) -> None:
    """Write a checkpoint in one step: tensors and plain values only."""
    import torch

    # Strides are part of the file: a clone forgets whether the network ran with channels last.
    tensors = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in state.items()
    }
    checkpoint.write(path, {"kind": KIND, "backbone": backbone, "net": tensors})


def read_weights(path: Path, mend: str) -> Weights:
    """Read a checkpoint of :func:`write_weights`; `mend` ends the messages: what to do if it is none.

    Raises InputError if it is missing, cut short or no checkpoint of a unified encoder.
    """
    content = checkpoint.read(path, KIND, mend)
    if not isinstance(content.get("backbone"), str) or not _is_state(content.get("net")):
        raise InputError(f"{path} lacks the backbone's name or the network's tensors. {mend}")
    return Weights(path, content["backbone"], content["net"])


def read_published(path: Path, mend: str) -> dict[str, Any]:
    """Return the tensors by name of a plain state dict, alone in its file or beside settings of its training.

    Raises InputError if the file is cut short, or holds code, or no tensors.
    """
    content = checkpoint.load(path, mend)
    candidates = [content, *(content.get(name) for name in WRAPPERS)] if isinstance(content, dict) else []
    for state in candidates:
        if _is_state(state) and state:
            return dict(state)
    raise InputError(f"{path} is no plain state dict, tensors by name. {mend}")


def _is_state(value: Any) -> bool:
    import torch

    return isinstance(value, dict) and all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor) for name, tensor in value.items()
    )


def files(setting: Setting, key: str) -> dict[str, str]:
    """Return the files that a setting of this `key` names, each under its own key."""
    if isinstance(setting, str):
        return {key: setting}
    return {f"{key}.{part}": file for part, file in (setting or {}).items()}


def fill(model: Any, backbone: str, setting: Setting, key: str) -> list[Source]:
    """Fill a unified encoder's parts as a setting says; return the files that were used.

    Args:
        model: a torch module with the children backbone, depth_head and class_head.
        backbone: what kind it is.
        setting: its files, each a path or URL as :func:`pipeline.encoder.download.find` takes them.
        key: the setting's name in params.yaml, for messages.

    Raises InputError if a file is missing, is not what its hash says, or does not fit the network one by one.
    """
    mend = f"Name another file in {key}"
    if setting is None:
        return []
    if isinstance(setting, str):
        path, sha256 = find(setting, key)
        weights = read_weights(path, f"{mend}; a published file is named by part: {key}: {{backbone: {path}}}")
        if weights.backbone != backbone:
            raise InputError(f"{path} holds backbone {weights.backbone!r}, {backbone!r} is asked for. {mend}")
        checkpoint.load_state(model, weights.state, path, mend)
        return [Source("all", str(path), sha256)]
    sources = []
    for name, file in setting.items():
        path, sha256 = find(file, f"{key}.{name}")
        part = getattr(model, name)
        checkpoint.load_state(part, part.own_names(read_published(path, mend)), path, mend)
        sources.append(Source(name, str(path), sha256))
    return sources
