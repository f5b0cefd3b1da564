"""Learning rate over the steps of a fit, and precision of its products."""

import math

import torch


def warm_up_cosine(progress: float, warm_up: float) -> float:
    """Return the factor of the learning rate at `progress` in [0,1]: linear up to `warm_up`, then half a cosine."""
    if progress < warm_up:
        return 0.05 + 0.95 * progress / warm_up
    return 0.5 * (1 + math.cos(math.pi * (progress - warm_up) / (1 - warm_up)))


def autocast(device: torch.device, precision: str) -> torch.autocast:
    """Return the context of a forward pass.

    With `precision` auto products are in bfloat16 on a GPU that has it, otherwise in the weights' precision.
    """
    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "auto" and native)
