"""The fitted encoder: its file, and depth and classes of images by it, as they are stored."""

from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.executors import default_workers
from pipeline.camera import classes
from pipeline.camera.images import to_units
from pipeline.fitting import checkpoint
from pipeline.fitting.precision import autocast
from pipeline.fitting.prefetch import side_by_side

FILE = "encoder.pt"
KIND = "unified encoder"
T = TypeVar("T")
R = TypeVar("R")


class Weights(NamedTuple):
    """A checkpoint's content: the backbone that it is for, and the network's tensors by name."""

    backbone: str
    state: Mapping[str, Tensor]


def save(folder: Path, backbone: str, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step: the backbone's name, and a network's tensors by name."""
    # Strides are part of the file: a clone forgets whether the network ran with channels last.
    tensors = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in state.items()
    }
    checkpoint.write(folder / FILE, {"kind": KIND, "backbone": backbone, "net": tensors})


def read(path: Path) -> Weights:
    """Read a file of :func:`save`. Raises InputError if it is missing, cut short, or not a checkpoint of an encoder."""
    content = checkpoint.read(path, KIND)
    if not isinstance(content.get("backbone"), str) or not is_state(content.get("net")):
        raise InputError(f"{path} lacks the backbone's name or the network's tensors")
    return Weights(content["backbone"], content["net"])


def is_state(value: Any) -> bool:
    """Whether `value` holds tensors by name, and nothing else."""
    return isinstance(value, dict) and all(
        isinstance(name, str) and isinstance(tensor, Tensor) for name, tensor in value.items()
    )


def load(folder: Path) -> UnifiedEncoder:
    """Return the encoder that stage encoder wrote to `folder`, ready to perceive, on the GPU where there is one.

    Raises InputError if its file is missing, damaged or does not fit this code, or if its backbone needs a package that
    is not installed.
    """
    path, hint = folder / FILE, "Make it again: dvc repro --force --single-item encoder"
    with error_context(fix=hint):
        backbone, state = read(path)
        if backbone not in BACKBONES:
            raise InputError(
                f"{path} holds backbone {backbone!r}, which this code lacks: {closest(backbone, list(BACKBONES))}"
            )
    with error_context(str(path)):
        model = UnifiedEncoder(backbone)
    with error_context(fix=hint):
        checkpoint.load_state(model, state, path)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # 1.6x faster on a CPU, measured
    return model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def perceive(
    model: nn.Module, images: np.ndarray, K: np.ndarray, precision: str = "float32"
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth float32 [B,H,W] in metres and trainIds uint8 [B,H,W] of RGB images uint8 [B,H,W,3].

    `K` [3,3] are the intrinsics of these images. One forward pass of `model`, which is in evaluation mode, with
    products in `precision`, of section perception. On a CPU, one image after the other: an image's last bits depend on
    whether others are beside it, and a live camera shows one at a time.
    """
    device = next(model.parameters()).device
    at_once = 1 if device.type == "cpu" else len(images)
    with torch.inference_mode(), autocast(device, precision):
        intrinsics = torch.from_numpy(K).to(device)
        seen = [
            model(part.to(device).permute(0, 3, 1, 2), intrinsics.expand(len(part), 3, 3))
            for part in torch.split(torch.from_numpy(images), at_once)
        ]
        depth, cls = (torch.cat(parts) for parts in zip(*((d.float(), likeliest(c)) for d, c in seen), strict=True))
        return depth.cpu().numpy(), cls.to(torch.uint8).cpu().numpy()


def passes(forward: Callable[[T], R], batches: Generator[T]) -> Generator[R]:
    """Yield ``forward(batch)`` of each batch, in order, and the same bytes for any number of cores.

    How a sum is split among threads shows in its last bits. So each forward pass on a CPU runs on one thread, and as
    many of them side by side as torch would have taken threads; a GPU runs one after the other. Closes `batches`.
    """
    threads = torch.get_num_threads()
    alone = partial(torch.set_num_threads, 1)
    side = 1 if torch.cuda.is_available() else min(threads, default_workers())  # STEER_WORKERS bounds the memory
    alone()
    try:
        # Each thread that works has a number of its own.
        with closing(side_by_side(forward, batches, side, start=alone)) as results:
            yield from results
    finally:
        torch.set_num_threads(threads)


def likeliest(logits: Tensor) -> Tensor:
    """Return trainIds int64 [B,H,W] of logits [B,19,H,W], or [B,20,H,W] whose last is void."""
    cls = logits.argmax(dim=1)
    return cls.masked_fill_(cls == classes.COUNT, classes.VOID)


def stored_depth(depth_m: np.ndarray, cls: np.ndarray) -> np.ndarray:
    """Return depth as uint16 in 1/256 m, 0 where there is none: in the sky, and where `depth_m` is 0."""
    return to_units(np.where(cls == classes.SKY, 0, depth_m))
