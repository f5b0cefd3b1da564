"""Fit the unified encoder to depth and classes of the training drives."""

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from tqdm import tqdm

from models.encoder.unified_encoder import Architecture
from pipeline.base.errors import InputError
from pipeline.base.loop import prefetch, warm_up_cosine
from pipeline.base.runner import Summary
from pipeline.camera import classes
from pipeline.encoder.encoder_file import save
from pipeline.encoder.examples import Examples, augment
from pipeline.encoder.settings import Encoder

WARM_UP = 0.15  # share of the steps with a rising learning rate
WEIGHT_DECAY = 1e-4
MAX_RELATIVE_ERROR = 6.0


def fit_drives(
    path: Path,
    *,
    model: nn.Module,
    architecture: Architecture,
    settings: Encoder,
    ingest: Path,
    drives: Sequence[str],
) -> Summary:
    """Write the encoder fitted to drives of stage ingest to `path`. Return its curve, and keys of
    its config.json.
    """
    model.to("cuda" if torch.cuda.is_available() else "cpu")
    with Examples(ingest, drives, settings.frames) as examples:
        curve = fit(model, examples, settings)
        before = architecture.get("datasets", ["unknown"] if settings.weights else [])
        datasets = sorted({*before, *examples.datasets})
        save(path.parent, {**architecture, "datasets": datasets}, model.state_dict())
        config = {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}
        return {"frames": len(examples), "curve": curve, "config": config}


def fit(model: nn.Module, examples: Examples, settings: Encoder) -> list[dict[str, float]]:
    """Fit an encoder in place. Returns a row of mean losses per epoch. Raises InputError if the
    loss is not finite.
    """
    device, epochs = next(model.parameters()).device, settings.epochs
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.AdamW(model.parameters(), weight_decay=WEIGHT_DECAY, fused=True)
    curve = []
    steps = math.ceil(len(examples) / settings.batch)
    model.train()
    for epoch in range(epochs):
        start = time.perf_counter()
        torch.manual_seed(settings.seed + epoch)
        # read once per epoch: no step waits for a GPU
        sums = torch.zeros(2, dtype=torch.float64, device=device)
        batches = _batches(
            examples, settings.batch, np.random.default_rng([settings.seed, epoch]), device.type
        )
        bar = tqdm(
            batches, f"epoch {epoch + 1}/{epochs}", steps, unit="batch", leave=False, disable=None
        )
        for step, tensors in enumerate(bar):
            image, K, depth, cls = (tensor.to(device, non_blocking=True) for tensor in tensors)
            factor = warm_up_cosine((epoch * steps + step) / (epochs * steps), WARM_UP)
            optimiser.param_groups[0]["lr"] = settings.learning_rate * factor
            depth_m, logits = model(image.permute(0, 3, 1, 2), K)
            losses = depth_and_class_loss(depth_m, logits, depth, cls.long())
            optimiser.zero_grad(set_to_none=True)
            losses.sum().backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            sums += losses.detach()
        depth_loss, class_loss = (sums / steps).tolist()
        row = {
            "epoch": epoch + 1,
            "loss": depth_loss + class_loss,
            "depth": depth_loss,
            "classes": class_loss,
        }
        if not math.isfinite(row["loss"]):
            fix = f"Lower encoder.learning_rate (now {settings.learning_rate})"
            raise InputError(f"the loss is not finite in epoch {epoch + 1}", "encoder", fix)
        line = (
            "encoder: {epoch} of {epochs} epochs: loss {loss:.4f} (depth {depth:.4f}, classes "
            "{classes:.4f})"
        )
        print(
            f"{line.format(epochs=epochs, **row)}, {time.perf_counter() - start:.1f} s", flush=True
        )
        curve.append(row)
    model.eval()
    return curve


def depth_and_class_loss(
    depth_m: Tensor, logits: Tensor, true_depth_m: Tensor, true_cls: Tensor
) -> Tensor:
    """Return [depth loss, cross-entropy], means over the pixels with ground truth; 0 without any.

    The depth loss is the mean of |log d/d*| and |d - d*|/d*. Both are relative. The second, which
    is also the reported abs rel, penalises overestimates more: the first one alone loses thin
    nearby objects to their background.

    Args: predicted depth [B,H,W] and logits [B,19,H,W] (or 20); true depth [B,H,W] in metres, 0
    where unknown; true classes int64 [B,H,W], 255 where unknown.
    """
    known = true_depth_m > 0
    ratio = torch.where(known, depth_m / true_depth_m.clamp(min=1e-3), 1.0)
    # Clamped, as early predictions next to edges are tens of times too far and would dominate the
    # sum.
    error = 0.5 * torch.log(ratio).abs() + 0.5 * (ratio - 1).abs().clamp(max=MAX_RELATIVE_ERROR)
    depth_loss = error.sum() / known.sum().clamp(min=1)
    labelled = (true_cls != classes.VOID).sum().clamp(min=1)
    # The heads' memory order; softmax along the second axis would copy to planes and back.
    pixels, targets = logits.permute(0, 2, 3, 1).flatten(0, 2), true_cls.flatten()
    class_loss = (
        F.cross_entropy(pixels, targets, ignore_index=classes.VOID, reduction="sum") / labelled
    )
    return torch.stack([depth_loss, class_loss])


def _batches(
    examples: Examples, batch: int, rng: np.random.Generator, device: str
) -> Iterator[list[Tensor]]:
    """Return image [B,H,W,3], K, depth and classes of augmented examples in random order; ahead,
    pinned for a GPU.
    """

    def read(numbers: np.ndarray) -> list[Tensor]:
        chosen = [augment(examples[number], rng) for number in numbers.tolist()]
        arrays = zip(
            *((one.image, one.camera.K, one.depth_m, one.cls) for one in chosen), strict=True
        )
        tensors = [torch.from_numpy(np.stack(parts)) for parts in arrays]
        return [tensor.pin_memory() for tensor in tensors] if device == "cuda" else tensors

    order = rng.permutation(len(examples))
    groups = np.split(order, range(batch, len(order), batch))
    return prefetch(read, groups) if device == "cuda" else map(read, groups)
