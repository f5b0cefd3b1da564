"""Fit a steering network to the training drives: epochs, early stopping on validation, state saved for a resume."""

import csv
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pipeline import checkpoint, metrics, windows
from pipeline.errors import InputError
from pipeline.sections.train import Train

WARM_UP = 0.05  # share of the steps in which the learning rate rises
EVALUATION_WINDOWS = 96  # windows per batch when nothing is learned

Forward = Callable[[windows.Batch], Tensor]
"""A batch of arrays → standardised predictions [W] on the network's device."""


@dataclass(frozen=True)
class Target:
    """Mean and standard deviation of the training labels, rad: the network learns (Θ - mean) / std."""

    mean_rad: float
    std_rad: float

    @classmethod
    def of(cls, drives: Sequence[windows.Drive]) -> "Target":
        steering = np.concatenate([drive.steering_rad[drive.valid] for drive in drives])
        return cls(float(steering.mean()), max(float(steering.std()), 1e-6))  # a road without a bend has no spread


@dataclass(frozen=True)
class Epoch:
    """One row of curve.csv. Without validation drives the last two are NaN."""

    epoch: int
    learning_rate: float
    train_loss: float
    val_mse_rad2: float
    val_nmse: float


@dataclass(frozen=True)
class Fitted:
    """The curve, and the network's tensors after the best epoch."""

    curve: list[Epoch]
    best: dict[str, Tensor]


def fit(
    net: nn.Module,
    forward: Forward,
    train: Sequence[windows.Drive],
    val: Sequence[windows.Drive],
    *,
    window: int,
    alpha: float,
    settings: Train,
    seed: int,
    target: Target,
    kept: Path,
    about: Mapping[str, Any],
    title: str,
) -> Fitted:
    """Fit `net` in place; its weights end as the last epoch's.

    After each epoch the state goes to `kept`, and fitting goes on from there, to the same result, if that file exists.

    Args:
        window: frames per prediction; alpha: of the loss weights, per rad.
        about: what the state file says of the run beside its tensors.
        title: names the run in what is printed.

    Raises InputError if the loss is no longer finite.
    """
    kind = "steering net"
    optimiser = torch.optim.AdamW(net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
    curve: list[Epoch] = []
    best = copy_of(net)
    if kept.is_file():
        state = checkpoint.read(kept, kind, f"Delete {kept} to start again")
        net.load_state_dict(state["net"])
        optimiser.load_state_dict(state["optimiser"])
        curve, best = [Epoch(**row) for row in state["curve"]], state["best"]
        print(f"{title}: {len(curve)} of {settings.epochs} epochs kept from the run before", flush=True)

    started, done = time.perf_counter(), len(curve)
    while len(curve) < settings.epochs and not out_of_patience(curve, settings.patience):
        epoch = len(curve) + 1
        loss, rate = _train_epoch(net, forward, optimiser, train, window, alpha, settings, seed, epoch, target)
        if not math.isfinite(loss):
            raise InputError(f"{title}: the loss of epoch {epoch} is {loss}: lower train.learning_rate or clip_norm")
        mse, nmse = _validate(net, forward, val, window, target)
        curve.append(Epoch(epoch, rate, loss, mse, nmse))
        better = best_epoch(curve) == epoch
        if better:
            best = copy_of(net)
        checkpoint.write(
            kept,
            {**about, "kind": kind, "epoch": epoch, "net": copy_of(net), "best": best}
            | {"optimiser": optimiser.state_dict(), "curve": [asdict(row) for row in curve]},
        )
        eta = (time.perf_counter() - started) / (epoch - done) * (settings.epochs - epoch)
        judged = f", validation nmse {nmse:.3f}{' (best)' if better else ''}" if val else ""
        print(f"{title}: epoch {epoch}/{settings.epochs}, loss {loss:.4f}{judged}, {eta:.0f} s to go", flush=True)
    return Fitted(curve, best)


def best_epoch(curve: Sequence[Epoch]) -> int:
    """Return the number of the epoch with the least validation error; the last one if nothing was validated."""
    judged = [row for row in curve if not math.isnan(row.val_nmse)]
    return min(judged, key=lambda row: row.val_nmse).epoch if judged else len(curve)


def out_of_patience(curve: Sequence[Epoch], patience: int) -> bool:
    """Whether the last `patience` epochs brought no better validation error."""
    return len(curve) - best_epoch(curve) >= patience


def copy_of(net: nn.Module) -> dict[str, Tensor]:
    """Return the network's tensors as they are now, on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}


def predict_drives(
    net: nn.Module, forward: Forward, drives: Sequence[windows.Drive], window: int, target: Target
) -> list[np.ndarray]:
    """Return the steering in rad that `net` predicts for each drive's frames, [G] each; NaN where no window ends."""
    found = [np.full(len(drive.frame), np.nan) for drive in drives]
    groups = [[span] for span in windows.spans(drives, window, EVALUATION_WINDOWS)]
    net.eval()
    with torch.inference_mode():
        for (span,), batch in zip(groups, windows.batches(drives, groups, window), strict=True):
            predicted = forward(batch).double().cpu().numpy()
            found[span.drive][span.start + window - 1 : span.stop] = predicted * target.std_rad + target.mean_rad
    return found


def weighted_mse(predicted: Tensor, wanted: Tensor, weight: Tensor) -> Tensor:
    """Σ w (Θ̂ - Θ)² / Σ w over windows [W] (paper eq. 9); 0 if all weights are 0."""
    return (weight * (predicted - wanted).square()).sum() / weight.sum().clamp_min(torch.finfo(weight.dtype).tiny)


def ms_per_frame(encode: Forward, drives: Sequence[windows.Drive], window: int) -> float:
    """Return the median time of ``encode(batch)`` per frame of the batch, in ms, over a few batches after a warm-up."""
    groups = [[span] for span in windows.spans(drives, window, EVALUATION_WINDOWS)][:6]
    times = []
    with torch.inference_mode():
        for batch in windows.batches(drives, groups, window):
            started = time.perf_counter()
            encode(batch).cpu()  # waits for the device
            times.append((time.perf_counter() - started) / (len(batch["ptr"]) - 1))
    return float(np.median(times[1:] or times)) * 1e3


def _train_epoch(
    net: nn.Module,
    forward: Forward,
    optimiser: torch.optim.Optimizer,
    drives: Sequence[windows.Drive],
    window: int,
    alpha: float,
    settings: Train,
    seed: int,
    epoch: int,
    target: Target,
) -> tuple[float, float]:
    # Everything random in an epoch follows from its number: a resumed run goes on as if it had never stopped.
    rng = np.random.default_rng([seed, epoch])
    spans = windows.spans(drives, window, settings.run_windows, rng)
    groups = [spans[first : first + settings.batch_runs] for first in range(0, len(spans), settings.batch_runs)]
    net.train()
    losses, masses, rate = [], [], 0.0
    steps = zip(groups, windows.batches(drives, groups, window), strict=True)
    bar = tqdm(steps, f"epoch {epoch}", len(groups), unit="step", leave=False, disable=not sys.stderr.isatty())
    for step, (group, batch) in enumerate(bar):
        if settings.mirror:
            flipped = np.repeat(rng.random(len(group)) < 0.5, [span.stop - span.start for span in group])
            batch = windows.mirror(batch, flipped)
        rate = settings.learning_rate * _schedule((epoch - 1 + step / len(groups)) / settings.epochs)
        for parameters in optimiser.param_groups:
            parameters["lr"] = rate
        predicted = forward(batch)
        steering = torch.from_numpy(batch["steering_rad"]).to(predicted)
        weight = torch.from_numpy(batch["valid"]).to(predicted) * torch.exp(alpha * steering.abs())
        loss = weighted_mse(predicted, (steering - target.mean_rad) / target.std_rad, weight)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), settings.clip_norm)
        optimiser.step()
        losses.append(loss.item())
        masses.append(float(weight.sum()))
    return float(np.average(losses, weights=masses)), rate


def _schedule(progress: float) -> float:
    """Factor of the learning rate after a share of all steps: linear warm-up, then half a cosine to zero."""
    if progress < WARM_UP:
        return 0.01 + 0.99 * progress / WARM_UP
    return 0.5 * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP)))


def _validate(
    net: nn.Module, forward: Forward, drives: Sequence[windows.Drive], window: int, target: Target
) -> tuple[float, float]:
    if not drives:
        return math.nan, math.nan
    found = np.concatenate(predict_drives(net, forward, drives, window, target))
    steering = np.concatenate([drive.steering_rad for drive in drives])
    judged = np.concatenate([drive.valid for drive in drives]) & ~np.isnan(found)
    result = metrics.scores(steering[judged], found[judged])
    return result["mse_rad2"], result["nmse"]


def write_curve(path: Path, curve: Sequence[Epoch]) -> None:
    """Write curve.csv, one row per epoch; what was not measured stays empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(field.name for field in fields(Epoch))
        for row in curve:
            rows.writerow("" if math.isnan(value) else f"{value:.6g}" for value in asdict(row).values())
