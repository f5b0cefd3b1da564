"""Fit a steering network to the training drives, with early stopping and resume."""

import copy
import csv
import math
import multiprocessing
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from pipeline.base.errors import InputError, error_context
from pipeline.base.executors import default_workers
from pipeline.base.files import replacing
from pipeline.settings.models import Entry
from pipeline.settings.train import Train
from pipeline.train import checkpoint, predict, reading, windows
from pipeline.train.labelled_drive import LabelledDrive
from pipeline.train.optimisation import autocast, warm_up_cosine
from pipeline.train.scale import Prediction, Scale, nmse

if TYPE_CHECKING:
    from models.steering.core.steering_net import SteeringNet

WARM_UP = 0.05  # share of the steps
SMOOTHING = 3  # epochs
MOTION_DROPOUT = 0.5
"""Share of the spans whose motion is hidden from a network that predicts ahead.

Motion alone is a good first guess, and a network that always has it learns to use the scene late or never. In these
spans it has to predict from the scene alone. docs/results.md has the effect.
"""


class Epoch(NamedTuple):
    """One row of curve.csv. Without validation drives, val_nmse is NaN."""

    epoch: int
    learning_rate: float
    train_loss: float
    val_nmse: float


def selected_epoch(curve: Sequence[Epoch]) -> int:
    """Return the number of the epoch whose weights are kept; the last one without validation.

    It has the lowest mean of the validation errors of this epoch and the two before, since one epoch's error is noisy.
    """
    errors = [row.val_nmse for row in curve]
    means = {
        end: math.fsum(errors[max(0, end - SMOOTHING) : end]) / min(SMOOTHING, end) for end in range(1, len(curve) + 1)
    }
    validated = [epoch for epoch, mean in means.items() if not math.isnan(mean)]
    return min(validated, key=means.__getitem__, default=len(curve))


def write_curve(path: Path, curve: Sequence[Epoch]) -> None:
    """Write curve.csv, one row per epoch; NaN becomes an empty field."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(Epoch._fields)
        rows.writerows(["" if math.isnan(value) else f"{value:.6g}" for value in row] for row in curve)


class Fit:
    """One training run: a network, the moving average of its weights, an optimiser, and the learning curve.

    The average is validated and selected: at a high learning rate single steps fluctuate, their mean does not.
    `best` holds the weights of the :func:`selected_epoch`.
    """

    def __init__(self, net: "SteeringNet", entry: Entry, settings: Train, seed: int, scale: Scale) -> None:
        self.net, self.entry, self.settings, self.seed, self.scale = net, entry, settings, seed, scale
        self.average = copy.deepcopy(net)
        # Weight decay for matrices only: an offset or a time constant need not be small.
        matrices = [parameter for parameter in net.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in net.parameters() if parameter.ndim <= 1]
        groups = [{"params": matrices, "weight_decay": settings.weight_decay}, {"params": vectors, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.learning_rate, fused=True)
        self.curve: list[Epoch] = []
        self.best = copy_weights(net)

    def run(
        self,
        train: Sequence[LabelledDrive],
        val: Sequence[LabelledDrive],
        state: Path,
        metadata: Mapping[str, Any],
        title: str,
    ) -> None:
        """Train until the last epoch, or until validation stops improving; results are `best`, `curve` and `scale`.

        After each epoch the file `state` is written, with the run's `metadata`. If it exists, training continues from
        it, to the same result. Raises InputError if the loss is not finite.
        """
        if state.is_file():
            with error_context(fix=f"Delete {state} to start again"):
                self._resume(checkpoint.read(state, predict.KIND))
            print(f"{title}: continues after epoch {len(self.curve)} of {self.settings.epochs}", flush=True)
        epochs, patience, dtype = self.settings.epochs, self.settings.patience, next(self.net.parameters()).dtype
        targets = partial(
            step_targets, scale=self.scale, alpha=self.entry.alpha, mirror=self.settings.mirror, dtype=dtype
        )
        on_gpu = self.net.device.type == "cuda"
        # Dask's workers start no processes.
        processes = default_workers() if on_gpu and not multiprocessing.current_process().daemon else 0
        with reading.Reader([*train, *val], self.entry.window, targets, processes, on_gpu) as reader:
            started, before = time.perf_counter(), len(self.curve)
            while (done := len(self.curve)) < epochs and done - selected_epoch(self.curve) < patience:
                epoch = done + 1
                loss, rate = self._train(reader, train, epoch)
                if not math.isfinite(loss):
                    problem = f"loss of epoch {epoch} is {loss}"
                    raise InputError(problem, title, "Lower train.learning_rate or clip_norm")
                error = nmse(val, self._predict(reader, val, len(train))) if val else math.nan
                self.curve.append(Epoch(epoch, rate, loss, error))
                selected = selected_epoch(self.curve) == epoch
                if selected:
                    self.best = copy_weights(self.average)
                checkpoint.write(state, {**metadata, **self._state(), "epoch": epoch})
                eta = (time.perf_counter() - started) / (epoch - before) * (epochs - epoch)
                text = f", validation nmse {error:.3f}{' (selected)' if selected else ''}" if val else ""
                # One write, as runs in parallel share the output; print writes the line's end separately.
                line = f"{title}: {epoch} of {epochs} epochs, loss {loss:.4f}{text}, ETA {eta:.0f} s\n"
                print(line, end="", flush=True)
            if self.entry.uncertainty and val:
                self.average.load_state_dict(self.best)
                self.scale = self.scale.calibrated(val, self._predict(reader, val, len(train)))

    def _predict(self, reader: reading.Reader, val: Sequence[LabelledDrive], first: int) -> list[Prediction]:
        """Return the average's predictions for the validation drives, which the reader numbers from `first` on."""
        spans = windows.spans(val, self.entry.window, predict.WINDOWS)
        batches = reader.batches([reading.Step([replace(span, drive=span.drive + first)]) for span in spans])
        return predict.predict_spans(self.average, val, spans, batches, self.scale)

    def _plan(self, drives: Sequence[LabelledDrive], epoch: int) -> list[reading.Step]:
        """Return the steps of an epoch.

        All random numbers of an epoch derive from its number, so a resumed run equals an uninterrupted one.
        """
        settings, rng = self.settings, np.random.default_rng([self.seed, epoch])
        hides = self.net.motion and bool(drives[0].horizon or drives[0].ahead_m)
        spans = windows.random_spans(drives, self.entry.window, settings.span_windows, rng)
        steps = []
        for first in range(0, len(spans), settings.batch_spans):
            group = spans[first : first + settings.batch_spans]
            factor = (settings.rescale ** rng.uniform(-1, 1, len(group))).astype(np.float32)
            hidden = rng.random(len(group)) < MOTION_DROPOUT if hides else None
            steps.append(reading.Step(group, factor, hidden))
        return steps

    def _train(self, reader: reading.Reader, drives: Sequence[LabelledDrive], epoch: int) -> tuple[float, float]:
        """Train for one epoch; return the mean loss and the last learning rate."""
        settings, device, net = self.settings, self.net.device, self.net
        steps, robust = self._plan(drives, epoch), self.entry.predict == "path"
        net.train()
        progress = (epoch - 1 + np.arange(len(steps)) / len(steps)) / settings.epochs
        rates = [settings.learning_rate * warm_up_cosine(share, WARM_UP) for share in progress.tolist()]
        errors, masses, precision = [], [], autocast(device, settings.precision)
        # Several bars on one terminal overwrite each other.
        hidden = multiprocessing.parent_process() is not None or not sys.stderr.isatty()
        bar = tqdm(reader.batches(steps), f"epoch {epoch}", len(steps), unit="step", leave=False, disable=hidden)
        for step, batch in enumerate(bar):
            for parameters in self.optimiser.param_groups:
                parameters["lr"] = rates[step]
            # Copied before the forward pass: the copies do not wait for it.
            residual, weight = (batch[name].to(device, non_blocking=True) for name in ("residual", "weight"))
            with precision:
                predicted = net(*net.inputs(batch), pairs=settings.mirror)
            error = weighted_loss(predicted, residual, weight, robust)
            # Each span has a valid target, but all ranges of a scaled path may be unknown: then the error is 0, too.
            mass = weight.sum().clamp_min(1e-6)
            self.optimiser.zero_grad(set_to_none=True)
            (error / mass).backward()
            nn.utils.clip_grad_norm_(net.parameters(), settings.clip_norm)
            self.optimiser.step()
            decay = settings.average if step or epoch > 1 else 0.0  # starts with the weights after the first step
            with torch.no_grad():
                torch._foreach_lerp_([*self.average.parameters()], [*net.parameters()], 1 - decay)
            errors.append(error.detach())
            masses.append(mass)
        error_sum, mass_sum = torch.stack(errors + masses).double().view(2, -1).sum(1).tolist()
        return error_sum / mass_sum, rates[-1]

    def _resume(self, state: Mapping[str, Any]) -> None:
        self.net.load_state_dict(state["net"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.best, self.curve = state["best"], [Epoch(**row) for row in state["curve"]]

    def _state(self) -> dict[str, Any]:
        return {
            "net": copy_weights(self.net),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best": self.best,
            "curve": [row._asdict() for row in self.curve],
        }


def copy_weights(net: nn.Module) -> dict[str, Tensor]:
    """Return a copy of the network's tensors on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}


def step_targets(
    batch: Mapping[str, Tensor], scale: Scale, alpha: float, mirror: bool, dtype: torch.dtype
) -> dict[str, Tensor]:
    """Return `residual`, the outputs that the network should have, and their `weight` in the loss, both [W,R].

    With `mirror` those of the mirrored windows follow.
    """
    target, base, weight = (batch[name].to(dtype) for name in ("target", "base", "valid"))
    residual = torch.from_numpy(scale.encode(target.numpy(), base.numpy()))
    weight = weight * torch.exp(alpha * target.abs())
    if mirror:
        residual, weight = torch.cat([residual, -residual]), torch.cat([weight, weight])
    return {"residual": residual, "weight": weight}


def weighted_loss(predicted: Tensor, target: Tensor, weight: Tensor, robust: bool) -> Tensor:
    """Return Σ w (ŷ - y)² over windows and columns [W,R]: paper eq. 9 when divided by Σ w.

    With `robust` Σ w Huber(ŷ - y), which is linear beyond one standard deviation: the path at a junction is the
    driver's choice, and squared errors there would dominate. With `predicted` [W,2R], ŷ and log σ, the negative
    log-likelihood Σ w (log σ + (ŷ - y)² / 2σ²), or Σ w (log σ + Huber((ŷ - y) / σ)), is added for σ alone. As the loss
    of ŷ, it gives hard windows a large σ instead of learning them.
    """
    criterion, half = (nn.functional.huber_loss, 1.0) if robust else (nn.functional.mse_loss, 0.5)
    mean, *log_sigma = predicted.reshape(len(target), -1, target.shape[1]).unbind(1)
    loss = criterion(mean, target, reduction="none")
    if log_sigma:
        scale = torch.exp(-log_sigma[0])
        loss = loss + log_sigma[0] + half * criterion(mean.detach() * scale, target * scale, reduction="none")
    return (weight * loss).sum()
