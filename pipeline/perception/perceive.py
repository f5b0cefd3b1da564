"""Save and load the fitted encoder, and predict depth and classes of images."""

from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import BACKBONES, UnifiedEncoder
from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.executors import default_workers
from pipeline.camera import classes
from pipeline.fitting import checkpoint
from pipeline.fitting.prefetch import side_by_side
from pipeline.fitting.steps import autocast

FILE = "encoder.pt"
KIND = "unified encoder"
T = TypeVar("T")
R = TypeVar("R")


class Saved(NamedTuple):
    """Content of ``encoder.pt``: the backbone's name and the network's tensors by name."""

    backbone: str
    state: Mapping[str, Tensor]


def save(folder: Path, backbone: str, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step."""
    # Strides are part of the file; a contiguous clone removes channels last.
    tensors = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in state.items()
    }
    checkpoint.write(folder / FILE, {"kind": KIND, "backbone": backbone, "net": tensors})


def read(path: Path) -> Saved:
    """Read a file of :func:`save`. Raises InputError if it is missing, damaged, or of another kind."""
    content = checkpoint.read(path, KIND)
    if not isinstance(content.get("backbone"), str) or not checkpoint.is_state(content.get("net")):
        raise InputError("expected the backbone's name and the network's tensors", path)
    return Saved(content["backbone"], content["net"])


def load(folder: Path) -> UnifiedEncoder:
    """Return the encoder of stage encoder in evaluation mode, on a GPU if there is one.

    Raises InputError if its file is missing, damaged or does not fit this code, or if a package is missing.
    """
    path, fix = folder / FILE, "Make it again: dvc repro --force --single-item encoder"
    with error_context(fix=fix):
        backbone, state = read(path)
        if backbone not in BACKBONES:
            raise InputError(f"unknown backbone {backbone!r}: {closest(backbone, list(BACKBONES))}", path)
    with error_context(path):
        model = UnifiedEncoder(backbone)
    with error_context(fix=fix):
        checkpoint.load_state(model, state, path)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # 1.6x faster on a CPU, measured
    return model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def perceive(
    model: nn.Module, images: np.ndarray, K: np.ndarray, precision: str = "float32"
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth float32 [B,H,W] in metres and trainIds uint8 [B,H,W] of RGB images uint8 [B,H,W,3].

    On a CPU, images run one by one: an image's last bits depend on the batch size, and steer predict has one at a time.

    Args:
        model: in evaluation mode.
        K: intrinsics [3,3] of these images.
        precision: of products, as in section perception.
    """
    device = next(model.parameters()).device
    at_once = 1 if device.type == "cpu" else len(images)
    with torch.inference_mode(), autocast(device, precision):
        intrinsics = torch.from_numpy(K).to(device)
        outputs = [
            model(part.to(device).permute(0, 3, 1, 2), intrinsics.expand(len(part), 3, 3))
            for part in torch.split(torch.from_numpy(images), at_once)
        ]
        depth = torch.cat([depth.float() for depth, _ in outputs])
        cls = torch.cat([likeliest(logits) for _, logits in outputs])
        return depth.cpu().numpy(), cls.to(torch.uint8).cpu().numpy()


def passes(forward: Callable[[T], R], batches: Generator[T]) -> Generator[R]:
    """Yield ``forward(batch)`` of each batch, in order, with equal bytes for any number of cores. Closes `batches`.

    The split of a sum among threads changes its last bits. So each forward pass on a CPU uses one thread, and several
    passes run side by side; a GPU runs one at a time.
    """
    threads = torch.get_num_threads()
    alone = partial(torch.set_num_threads, 1)
    side = 1 if torch.cuda.is_available() else min(threads, default_workers())  # STEER_WORKERS limits memory
    alone()
    try:
        with closing(side_by_side(forward, batches, side, side + 1, alone)) as results:
            yield from results
    finally:
        torch.set_num_threads(threads)


def likeliest(logits: Tensor) -> Tensor:
    """Return trainIds int64 [B,H,W] of logits [B,19,H,W], or [B,20,H,W] whose last is void."""
    cls = logits.argmax(dim=1)
    return cls.masked_fill_(cls == classes.COUNT, classes.VOID)
