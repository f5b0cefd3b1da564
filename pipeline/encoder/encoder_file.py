"""Write and read encoder.pt, the description and weights of an encoder; check its outputs."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import Architecture, build_network
from pipeline.base import checkpoint
from pipeline.camera.classes import COUNT
from pipeline.camera.images import Size

# Name of an encoder's file.
FILE = "encoder.pt"
# Kind of the checkpoint.
KIND = "unified encoder"


def save_encoder(folder: Path, architecture: Architecture, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step."""
    # A file stores the memory order of its tensors. All are copied to the default order, so that
    # equal weights make equal files.
    tensors = {}
    for name, tensor in state.items():
        tensors[name] = tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
    content = {"kind": KIND, "architecture": dict(architecture), "net": tensors}
    checkpoint.write(folder / FILE, content)


def load_encoder(path: Path) -> tuple[Architecture, nn.Module]:
    """Return description and network of a file. Raises InputError.

    The network is set to evaluation, and is on a GPU if the machine has one.
    """
    content = checkpoint.read(path, KIND)
    model = build_network(content["architecture"])
    checkpoint.load_state(model, content["net"], path)
    # Weights in the memory order of the images make the network 1.6 times as fast on a CPU.
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return content["architecture"], model.to(device).eval()


def check_size(model: nn.Module, size: Size) -> None:
    """Raise ValueError unless the network predicts depth and classes of images of `size` (H, W).

    The network is run on a grey image.
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
    logits_shape = tuple(logits.shape[1:])
    least = depth_m.min()
    most = depth_m.max()
    has_depth = 0 <= least <= most < np.inf and most > 0
    if not has_depth or depth_size != size or logits_shape != (COUNT, *size):
        raise ValueError(f"depth {depth_size} is {least:.3g} to {most:.3g}, logits {logits_shape}")
