"""The file of an encoder, encoder.pt: its description and weights; and whether a network suits the
images.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.encoder.unified_encoder import Architecture, build
from pipeline.base import checkpoint
from pipeline.camera.images import Size

FILE = "encoder.pt"
KIND = "unified encoder"


def save(folder: Path, architecture: Architecture, state: Mapping[str, Tensor]) -> None:
    """Write ``encoder.pt`` in one step."""
    # Strides are part of the file; a contiguous clone removes channels last.
    tensors = {
        name: x.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, x in state.items()
    }
    checkpoint.write(
        folder / FILE, {"kind": KIND, "architecture": dict(architecture), "net": tensors}
    )


def load(path: Path) -> tuple[Architecture, nn.Module]:
    """Return description and network of a file of :func:`save`, for evaluation, on a GPU if any.
    Raises InputError.
    """
    content = checkpoint.read(path, KIND)
    model = build(content["architecture"])
    checkpoint.load_state(model, content["net"], path)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # 1.6x faster on a CPU, measured
    return content["architecture"], model.to("cuda" if torch.cuda.is_available() else "cpu").eval()


def check_size(model: nn.Module, size: Size) -> None:
    """Raise ValueError unless the network predicts depth and classes of a grey image of `size` (H,
    W).
    """
    height, width = size
    device = next(model.parameters()).device
    image = torch.full((1, 3, height, width), 128, dtype=torch.uint8, device=device)
    K = torch.tensor(
        [[[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]]],
        dtype=torch.float64,
        device=device,
    )
    with torch.no_grad():
        depth, logits = model.eval()(image, K)
    depth_m = depth.float().cpu().numpy()
    classes = tuple(logits.shape[2:])
    if (
        {depth_m.shape[1:], classes} != {size}
        or not 0 <= depth_m.min() <= depth_m.max() < np.inf
        or not depth_m.any()
    ):
        raise ValueError(
            f"depth {depth_m.shape[1:]} is {depth_m.min():.3g} to {depth_m.max():.3g}, classes "
            f"{classes}"
        )
