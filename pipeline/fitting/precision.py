"""In which precision a network multiplies."""

import torch


def autocast(device: torch.device, precision: str) -> torch.autocast:
    """Return the context for a forward pass: products in bfloat16, or as the weights are.

    `precision` is ``bfloat16``, ``auto`` (bfloat16 on a GPU that has it), or anything else for as the weights are.
    """
    native = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.autocast(
        device.type, torch.bfloat16, enabled=precision == "bfloat16" or (precision == "auto" and native)
    )
