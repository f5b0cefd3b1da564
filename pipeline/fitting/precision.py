"""Precision of a network's products."""

import torch


def autocast(device: torch.device, precision: str) -> torch.autocast:
    """Return the context of a forward pass with products in bfloat16 or in the weights' precision.

    `precision` is ``bfloat16``, ``auto`` (bfloat16 on a GPU that has it), or any other text for the weights' precision.
    """
    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.autocast(
        device.type, torch.bfloat16, enabled=precision == "bfloat16" or (precision == "auto" and native)
    )
