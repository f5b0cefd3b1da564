"""Fit a network that gives depth and classes to what the training drives know."""

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from tqdm import tqdm

from pipeline.base.errors import InputError, error_context
from pipeline.camera import classes
from pipeline.encoder.examples import Examples, augment
from pipeline.fitting import checkpoint
from pipeline.fitting.schedule import warm_up_cosine

KIND = "unified encoder in fitting"
WARM_UP = 0.15  # share of the steps in which the learning rate rises
WEIGHT_DECAY = 1e-4
MAX_RELATIVE_ERROR = 6.0


@dataclass(frozen=True)
class EpochLoss:
    """Means over an epoch's steps of what :func:`depth_and_class_loss` gives, and their sum."""

    epoch: int
    loss: float
    depth: float
    classes: float


def fit(
    model: nn.Module,
    examples: Examples,
    *,
    epochs: int,
    batch: int,
    learning_rate: float,
    seed: int,
    kept: Path,
) -> list[EpochLoss]:
    """Fit `model` (image uint8 [B,3,H,W], K [B,3,3] → depth [B,H,W], logits) in place; return its losses.

    A part (backbone, head) whose parameters require no gradients stays as it is, batch statistics included. After each
    epoch the state goes to `kept`; if that file exists, fitting goes on from it, to the same result. Raises InputError
    if the loss is no longer finite.
    """
    device = next(model.parameters()).device
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    fitted = [parameter for parameter in model.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(fitted, weight_decay=WEIGHT_DECAY, fused=True)
    curve: list[EpochLoss] = []
    if kept.is_file():
        with error_context(fix=f"Delete {kept} to start again"):
            state = checkpoint.read(kept, KIND)
        model.load_state_dict(state["net"])
        optimiser.load_state_dict(state["optimiser"])
        curve = [EpochLoss(**row) for row in state["curve"]]
        print(f"{len(curve)} of {epochs} epochs kept from the run before", flush=True)

    steps = math.ceil(len(examples) / batch)
    terminal = sys.stderr.isatty()
    bar = tqdm(total=epochs * steps, initial=len(curve) * steps, unit="batch", disable=not terminal)
    for part in model.children():
        part.train(any(parameter.requires_grad for parameter in part.parameters()))
    for epoch in range(len(curve), epochs):
        start = time.perf_counter()
        torch.manual_seed(seed + epoch)  # what a head drops out at random is the same in a run that was resumed
        sums = torch.zeros(2, dtype=torch.float64)
        for step, (image, K, depth, cls) in enumerate(_batches(examples, batch, np.random.default_rng([seed, epoch]))):
            for group in optimiser.param_groups:
                group["lr"] = learning_rate * warm_up_cosine((epoch * steps + step) / (epochs * steps), WARM_UP)
            depth_m, logits = model(image.to(device), K.to(device))
            losses = depth_and_class_loss(depth_m, logits, depth.to(device), cls.to(device))
            optimiser.zero_grad(set_to_none=True)
            losses.sum().backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            sums += losses.detach().cpu()
            bar.update()
        depth_loss, class_loss = (sums / steps).tolist()
        curve.append(EpochLoss(epoch + 1, depth_loss + class_loss, depth_loss, class_loss))
        if not math.isfinite(curve[-1].loss):
            raise InputError(
                f"the encoder's loss is no longer finite in epoch {epoch + 1}: "
                f"lower encoder.learning_rate (now {learning_rate})"
            )
        line = (
            f"epoch {epoch + 1}/{epochs}: loss {curve[-1].loss:.4f} (depth {depth_loss:.4f}, classes {class_loss:.4f})"
        )
        if terminal:
            bar.set_postfix_str(line, refresh=False)
        else:
            print(f"{line}, {time.perf_counter() - start:.1f} s", flush=True)
        state = {"net": model.state_dict(), "optimiser": optimiser.state_dict(), "curve": [vars(row) for row in curve]}
        checkpoint.write(kept, {"kind": KIND, **state})
    bar.close()
    model.eval()
    return curve


def depth_and_class_loss(depth_m: Tensor, logits: Tensor, true_depth_m: Tensor, true_cls: Tensor) -> Tensor:
    """Return [depth loss, cross-entropy], each a mean over the pixels that have a truth; zero for the one without any.

    The depth loss is the mean of |log d/d*| and |d - d*|/d*. Both are relative; the second, which is the abs rel that
    is reported, weighs more what is taken for too far: thin things nearby, which the first gives up for what is behind.

    Args: depth [B,H,W] and logits [B,19,H,W] (or 20) as predicted; true depth [B,H,W] in metres, 0 where unknown; true
    classes int64 [B,H,W], 255 where unknown.
    """
    known = true_depth_m > 0
    ratio = torch.where(known, depth_m / true_depth_m.clamp(min=1e-3), 1.0)
    # A few pixels next to an edge may be tens of times too far early on; they must not drown the rest.
    error = 0.5 * torch.log(ratio).abs() + 0.5 * (ratio - 1).abs().clamp(max=MAX_RELATIVE_ERROR)
    depth_loss = error.sum() / known.sum().clamp(min=1)
    labelled = (true_cls != classes.VOID).sum().clamp(min=1)
    # Pixel by pixel, as heads leave them; along the second axis, softmax would copy them to planes and back.
    pixels, names = logits.permute(0, 2, 3, 1).flatten(0, 2), true_cls.flatten()
    class_loss = F.cross_entropy(pixels, names, ignore_index=classes.VOID, reduction="sum") / labelled
    return torch.stack([depth_loss, class_loss])


def _batches(examples: Examples, batch: int, rng: np.random.Generator) -> Iterator[tuple[Tensor, ...]]:
    order = rng.permutation(len(examples))
    for start in range(0, len(order), batch):
        chosen = [augment(examples[int(i)], rng) for i in order[start : start + batch]]
        yield (
            torch.from_numpy(np.stack([example.image for example in chosen])).permute(0, 3, 1, 2),
            torch.from_numpy(np.stack([example.K for example in chosen])),
            torch.from_numpy(np.stack([example.depth_m for example in chosen])),
            torch.from_numpy(np.stack([example.cls for example in chosen])).long(),
        )
