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
from pipeline.base.summary import Summary
from pipeline.camera import classes
from pipeline.encoder.encoder_file import save_encoder
from pipeline.encoder.examples import Examples, augment_example
from pipeline.encoder.settings import Encoder

# Share of the steps in which the learning rate rises.
WARM_UP = 0.15
# Weight decay, the coefficient of AdamW.
WEIGHT_DECAY = 1e-4
# Largest relative error of a pixel's depth; larger errors count as this error. Early predictions
# next to edges are tens of times too far and would dominate the sum.
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
    """Fit an encoder to drives of stage ingest, and write it to `path`.

    Returns the number of frames, the learning curve, and values for the encoder's config.json.
    """
    model.to("cuda" if torch.cuda.is_available() else "cpu")
    with Examples(ingest, drives, settings.frames) as examples:
        curve = fit_encoder(model, examples, settings)
        # The encoder's file lists the datasets it was fitted to, before and now. If the file of the
        # first weights lists none, the earlier ones are "unknown".
        datasets = {*examples.datasets, *architecture.get("datasets", [])}
        if settings.weights and "datasets" not in architecture:
            datasets.add("unknown")
        save_encoder(
            path.parent, {**architecture, "datasets": sorted(datasets)}, model.state_dict()
        )
        config = {"frames_per_drive": examples.frames_per_drive, "image_size": list(examples.size)}
        return {"frames": len(examples), "curve": curve, "config": config}


def fit_encoder(model: nn.Module, examples: Examples, settings: Encoder) -> list[dict[str, float]]:
    """Fit an encoder in place. Return for each epoch a row of mean losses.

    Raises InputError if the loss is not finite.
    """
    device = next(model.parameters()).device
    epochs = settings.epochs
    steps = math.ceil(len(examples) / settings.batch)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    model.train()
    optimiser = torch.optim.AdamW(model.parameters(), weight_decay=WEIGHT_DECAY, fused=True)
    curve = []
    for epoch in range(epochs):
        start = time.perf_counter()
        torch.manual_seed(settings.seed + epoch)
        rng = np.random.default_rng([settings.seed, epoch])
        batches = _read_batches(examples, settings.batch, rng, device=device.type)
        title = f"epoch {epoch + 1}/{epochs}"
        bar = tqdm(batches, title, steps, unit="batch", leave=False, disable=None)
        # The sums of the losses are read once per epoch, so that no step waits for a GPU.
        sums = torch.zeros(2, dtype=torch.float64, device=device)
        for step, tensors in enumerate(bar):
            factor = warm_up_cosine((epoch * steps + step) / (epochs * steps), WARM_UP)
            optimiser.param_groups[0]["lr"] = settings.learning_rate * factor

            tensors = [tensor.to(device, non_blocking=True) for tensor in tensors]
            image, K, true_depth_m, true_cls = tensors
            depth_m, logits = model(image.permute(0, 3, 1, 2), K)
            losses = depth_and_class_loss(depth_m, logits, true_depth_m, true_cls.long())
            optimiser.zero_grad(set_to_none=True)
            losses.sum().backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            sums += losses.detach()

        depth_loss, class_loss = (sums / steps).tolist()
        loss = depth_loss + class_loss
        if not math.isfinite(loss):
            fix = f"Lower encoder.learning_rate (now {settings.learning_rate})"
            raise InputError(f"the loss is not finite in epoch {epoch + 1}", "encoder", fix)
        curve.append({"epoch": epoch + 1, "loss": loss, "depth": depth_loss, "classes": class_loss})
        print(
            f"encoder: {epoch + 1} of {epochs} epochs: loss {loss:.4f} (depth {depth_loss:.4f}, "
            f"classes {class_loss:.4f}), {time.perf_counter() - start:.1f} s",
            flush=True,
        )
    model.eval()
    return curve


def depth_and_class_loss(
    depth_m: Tensor, logits: Tensor, true_depth_m: Tensor, true_cls: Tensor
) -> Tensor:
    """Return the depth loss and the cross-entropy of the classes, [2].

    Each is a mean over the pixels with ground truth, or 0 if no pixel has it. The depth loss of a
    pixel is the mean of |log d/d*| and |d - d*|/d*, for predicted depth d and true depth d*. Both
    are relative errors. The second, which is also the reported abs rel, penalises overestimates
    more. With the first alone, thin nearby objects get the depth of their background.

    Args:
        depth_m: predicted depth [B,H,W] in metres.
        logits: [B,19,H,W].
        true_depth_m: [B,H,W] in metres, 0 where unknown.
        true_cls: trainIds int64 [B,H,W], 255 where unknown.
    """
    is_known = true_depth_m > 0
    ratio = torch.where(is_known, depth_m / true_depth_m.clamp(min=1e-3), 1.0)
    relative_error = (ratio - 1).abs().clamp(max=MAX_RELATIVE_ERROR)
    error = 0.5 * torch.log(ratio).abs() + 0.5 * relative_error
    depth_loss = error.sum() / is_known.sum().clamp(min=1)

    # The model computes in channels-last order, in which the logits of a pixel lie next to each
    # other, and this view keeps it. A softmax along the second axis would copy all logits twice.
    pixels = logits.permute(0, 2, 3, 1).flatten(0, 2)
    targets = true_cls.flatten()
    error = F.cross_entropy(pixels, targets, ignore_index=classes.VOID, reduction="sum")
    class_loss = error / (true_cls != classes.VOID).sum().clamp(min=1)
    return torch.stack([depth_loss, class_loss])


def _read_batches(
    examples: Examples, batch: int, rng: np.random.Generator, device: str
) -> Iterator[list[Tensor]]:
    """Return batches of augmented examples in random order.

    A batch is images [B,H,W,3], intrinsics, depth and classes. For a GPU, batches are read ahead
    into pinned memory.
    """

    def read_batch(numbers: np.ndarray) -> list[Tensor]:
        rows = []
        for number in numbers.tolist():
            example = augment_example(examples[number], rng)
            rows.append((example.image, example.camera.K, example.depth_m, example.cls))
        tensors = [torch.from_numpy(np.stack(column)) for column in zip(*rows, strict=True)]
        if device == "cuda":
            return [tensor.pin_memory() for tensor in tensors]
        return tensors

    order = rng.permutation(len(examples))
    groups = np.split(order, range(batch, len(order), batch))
    if device == "cuda":
        return prefetch(read_batch, groups)
    return map(read_batch, groups)
