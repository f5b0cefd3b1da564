"""The file of an encoder, encoder.pt: its description and weights. A check of its outputs."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import Architecture, build
from pipeline.base import checkpoint
from pipeline.camera.images import Size

# Name of the file.
FILE = "encoder.pt"
# Kind of the checkpoint.
KIND = "unified encoder"


def save_encoder(folder: Path, architecture: Architecture, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step."""
    # Strides are part of the file; a contiguous clone removes channels last.
    tensors = {}
    for name, tensor in state.items():
        tensors[name] = tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
    content = {"kind": KIND, "architecture": dict(architecture), "net": tensors}
    checkpoint.write(folder / FILE, content)


def load_encoder(path: Path) -> tuple[Architecture, nn.Module]:
    """Return description and network of a file, for evaluation, on a GPU if there is one.

    Raises InputError.
    """
    content = checkpoint.read(path, KIND)
    model = build(content["architecture"])
    checkpoint.load_state(model, content["net"], path)
    # The memory order of images: 1.6x faster on a CPU, measured.
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return content["architecture"], model.to(device).eval()


def check_size(model: nn.Module, size: Size) -> None:
    """Raise ValueError unless the network predicts depth and classes of images of `size` (H, W).

    The image is grey.
    """
    height, width = size
    device = next(model.parameters()).device
    image = torch.full((1, 3, height, width), 128, dtype=torch.uint8, device=device)
    rows = [[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]]
    K = torch.tensor([rows], dtype=torch.float64, device=device)
    with torch.no_grad():
        depth, logits = model.eval()(image, K)
    depth_m = depth.float().cpu().numpy()
    depth_size = depth_m.shape[1:]
    class_size = tuple(logits.shape[2:])
    least = depth_m.min()
    most = depth_m.max()
    has_depth = 0 <= least <= most < np.inf and most > 0
    if not has_depth or depth_size != size or class_size != size:
        raise ValueError(f"depth {depth_size} is {least:.3g} to {most:.3g}, classes {class_size}")
