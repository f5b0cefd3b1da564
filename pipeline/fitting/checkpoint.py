"""Files of tensors: written in one step, read without running anything they hold, loaded only if all fits."""

import errno
import io
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError


def write(path: Path, content: Mapping[str, Any]) -> None:
    """Write tensors and plain values under their names; nobody ever reads a half-written file.

    Equal content gives equal bytes, be it made in this process or read from a file.
    """
    import torch

    # By way of memory: on a full disk torch's own writer raises RuntimeError, a plain file an OSError that says so.
    buffer = io.BytesIO()
    torch.save(_plain(content), buffer)
    with replacing(path) as tmp:
        tmp.write_bytes(buffer.getbuffer())


def _plain(value: Any) -> Any:
    """Return a copy in which equal texts are one object, and nothing else is: pickle writes an object once.

    Otherwise a run that went on from a file would write other bytes, for it has its texts from there.
    """
    if isinstance(value, Mapping):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return type(value)(map(_plain, value))
    return sys.intern(value) if type(value) is str else value


def read(path: Path, kind: str) -> dict[str, Any]:
    """Read a file of :func:`write` onto the CPU.

    Args:
        kind: what `content["kind"]` must be, for instance "steering net".

    Raises InputError if it is missing, cut short, or another kind of file; callers know what to do about it.
    """
    content = load(path)
    if not isinstance(content, dict) or content.get("kind") != kind:
        raise InputError(f"{path} is not a checkpoint of this project's {kind}")
    return content


def load(path: Path) -> Any:
    """Return what a file of torch.save holds, tensors and numbers on the CPU; code in it is refused, never run.

    Raises InputError if it is missing, damaged, or holds more than tensors and plain values.
    """
    import numpy as np
    import torch
    from numpy._core.multiarray import scalar

    # DINOv2's published depth heads hold numpy numbers beside their tensors, pickled under numpy 1's name.
    numbers: list[Any] = [
        (scalar, "numpy.core.multiarray.scalar"),
        scalar,
        np.dtype,
        np.dtypes.Float64DType,
        np.dtypes.Int64DType,
    ]

    if not path.is_file():
        raise InputError(f"{path} is missing")
    try:
        _check(path)
        with torch.serialization.safe_globals(numbers):
            return torch.load(path, weights_only=True, map_location="cpu")
    except InputError:
        raise
    except Exception as error:  # torch raises half a dozen kinds for a damaged file, OSError to UnpicklingError
        # EINVAL: its index points before its beginning. Other numbers are of the system: no permission, a bad disk.
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise InputError(f"{path} is cut short, or holds more than tensors and plain values") from error


def _check(path: Path) -> None:
    """Verify the checksums of an archive, which torch does not: it would load flipped bits. Old files have none."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise InputError(f"{path} is not a file of torch.save, which compresses nothing")
            damaged = archive.testzip()
        if damaged:
            raise InputError(f"{path} is damaged: the checksum of {damaged} in it is wrong")


def load_state(module: Any, state: Mapping[str, Any], path: Path) -> None:
    """Copy tensors into a torch module.

    Raises InputError unless names and shapes agree one by one, and all numbers are finite.
    """
    own = module.state_dict()
    for name in sorted(own.keys() | set(map(str, state))):
        if name not in state:
            fault = f"lacks {name}"
        elif name not in own:
            fault = f"has {name}, which the network lacks"
        elif not hasattr(state[name], "isfinite"):
            fault = f"has {type(state[name]).__name__} as {name}, and not a tensor"
        elif state[name].shape != own[name].shape:
            fault = f"has {name} of shape {list(state[name].shape)}, the network {list(own[name].shape)}"
        elif not state[name].isfinite().all():
            fault = f"has numbers in {name} that are not finite"
        else:
            continue
        raise InputError(f"{path} does not fit the network of this code: it {fault}")
    module.load_state_dict(state, strict=True)
