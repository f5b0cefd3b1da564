"""Depth and classes of images by a fitted network, as they are stored."""

import numpy as np
import torch
from torch import Tensor, nn

from pipeline.camera import classes
from pipeline.fitting.precision import autocast

UNITS_PER_M = 256
MAX_UNITS = 65535


def perceive(
    model: nn.Module, images: np.ndarray, K: np.ndarray, precision: str = "float32"
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth float32 [B,H,W] in metres and trainIds uint8 [B,H,W] of RGB images uint8 [B,H,W,3].

    `K` [3,3] are the intrinsics of these images. One forward pass of `model`, which is in evaluation mode, with
    products in `precision`, of section perception.
    """
    device = next(model.parameters()).device
    with torch.inference_mode(), autocast(device, precision):
        batch = torch.from_numpy(images).to(device).permute(0, 3, 1, 2)
        depth, logits = model(batch, torch.from_numpy(K).to(device).expand(len(images), 3, 3))
        return depth.float().cpu().numpy(), likeliest(logits).to(torch.uint8).cpu().numpy()


def likeliest(logits: Tensor) -> Tensor:
    """Return trainIds int64 [B,H,W] of logits [B,19,H,W], or [B,20,H,W] whose last is void."""
    cls = logits.argmax(dim=1)
    return cls.masked_fill_(cls == classes.COUNT, classes.VOID)


def stored_depth(depth_m: np.ndarray, cls: np.ndarray) -> np.ndarray:
    """Return depth as uint16 in 1/256 m, 0 where there is none: in the sky, and where `depth_m` is 0."""
    units = np.clip(np.rint(depth_m * UNITS_PER_M), 1, MAX_UNITS).astype(np.uint16)
    units[(cls == classes.SKY) | (depth_m == 0)] = 0
    return units
