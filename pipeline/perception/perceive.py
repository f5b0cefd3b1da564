"""Predict depth and classes of images with the encoder of a folder: a network, or precomputed files."""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import Architecture, build
from pipeline.base.errors import error_context
from pipeline.base.executors import default_workers
from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.perception import precomputed
from pipeline.train import checkpoint
from pipeline.train.loop import autocast, side_by_side

FILE = "encoder.pt"
KIND = "unified encoder"
GPU_BATCH = 32  # images per pass at least; a CPU runs them one by one
T = TypeVar("T")
R = TypeVar("R")


class EncoderInput(NamedTuple):
    """B frames of a drive."""

    drive: str
    frame: Sequence[int] | np.ndarray  # KITTI frame numbers [B]
    images: np.ndarray  # RGB uint8 [B,H,W,3]
    camera: Camera


Predict = Callable[[EncoderInput], tuple[np.ndarray, np.ndarray]]
"""EncoderInput → depth float32 [B,H,W] in the encoder's unit, trainIds uint8 [B,H,W]."""


def open_encoder(folder: Path, precision: str) -> Predict:
    """Return the function of the encoder in the folder of stage encoder; `precision` as in section perception.

    Raises InputError if its file is missing, damaged or does not fit this code, or if a package is missing.
    """
    if files := precomputed.named_in(folder):
        return partial(_read_precomputed, files)
    network = load(folder)
    return lambda batch: perceive(network, batch.images, batch.camera, precision)


def _read_precomputed(folder: Path, batch: EncoderInput) -> tuple[np.ndarray, np.ndarray]:
    frames = [precomputed.read(folder, batch.drive, int(frame), batch.camera.size) for frame in batch.frame]
    return np.stack([depth for depth, _ in frames]), np.stack([cls for _, cls in frames])


def weights_file(folder: Path) -> Path:
    """Return the file of an encoder's folder that determines its predictions."""
    return folder / (precomputed.FILE if precomputed.named_in(folder) else FILE)


def save(folder: Path, architecture: Architecture, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step."""
    # Strides are part of the file; a contiguous clone removes channels last.
    tensors = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in state.items()
    }
    checkpoint.write(folder / FILE, {"kind": KIND, "architecture": dict(architecture), "net": tensors})


def read(path: Path) -> tuple[Architecture, Mapping[str, Tensor]]:
    """Return the description and tensors by name of a file of :func:`save`. Raises InputError."""
    content = checkpoint.read(path, KIND)
    return content["architecture"], content["net"]


def load(folder: Path) -> nn.Module:
    """Return the encoder of stage encoder in evaluation mode, on a GPU if there is one.

    Raises InputError if its file is missing, damaged or does not fit this code, or if a package is missing.
    """
    path = folder / FILE
    with error_context(fix="Make it again: dvc repro --force --single-item encoder"):
        architecture, state = read(path)
        model = build(architecture)
        checkpoint.load_state(model, state, path)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # 1.6x faster on a CPU, measured
    return model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def perceive(
    model: nn.Module, images: np.ndarray, camera: Camera, precision: str = "float32"
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth float32 [B,H,W] in metres and trainIds uint8 [B,H,W] of RGB images uint8 [B,H,W,3].

    On a CPU, images run one by one: an image's last bits depend on the batch size, and steer predict has one at a time.

    Args:
        model: in evaluation mode.
        camera: of these images.
        precision: of products, as in section perception.
    """
    device = next(model.parameters()).device
    tensors, at_once = [torch.from_numpy(images), torch.from_numpy(camera.K)], 1
    if device.type != "cpu":
        tensors, at_once = [tensor.pin_memory() for tensor in tensors], len(images)
    with torch.inference_mode(), autocast(device, precision):
        pixels, intrinsics = (tensor.to(device, non_blocking=True) for tensor in tensors)
        outputs = [
            model(part.permute(0, 3, 1, 2), intrinsics.expand(len(part), 3, 3)) for part in torch.split(pixels, at_once)
        ]
        depth = torch.cat([depth.float() for depth, _ in outputs])
        cls = torch.cat([likeliest(logits) for _, logits in outputs])
        return depth.cpu().numpy(), cls.to(torch.uint8).cpu().numpy()


def passes(forward: Callable[[T], R], batches: Generator[T]) -> Generator[R]:
    """Yield ``forward(batch)`` of each batch, in order, with equal bytes for any number of cores. Closes `batches`.

    Splitting a sum among threads changes its last bits. So each forward pass on a CPU uses one thread, and several
    passes run side by side; a GPU runs one pass at a time.
    """
    threads = torch.get_num_threads()
    use_one_thread = partial(torch.set_num_threads, 1)
    workers = 1 if torch.cuda.is_available() else min(threads, default_workers())  # STEER_WORKERS limits memory
    use_one_thread()
    try:
        with closing(side_by_side(forward, batches, workers, workers + 1, use_one_thread)) as results:
            yield from results
    finally:
        torch.set_num_threads(threads)


def likeliest(logits: Tensor) -> Tensor:
    """Return trainIds int64 [B,H,W] of logits [B,19,H,W], or [B,20,H,W] whose last is void."""
    cls = logits.argmax(dim=1)
    return cls.masked_fill_(cls == classes.COUNT, classes.VOID)
