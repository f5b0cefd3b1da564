"""Fit a steering network to the training drives, with early stopping and resume."""

import copy
import math
import multiprocessing
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from tqdm import tqdm

from pipeline.base.errors import InputError, error_context
from pipeline.settings.train import Train
from pipeline.train import checkpoint, predict, reading, windows
from pipeline.train.curve import Epoch, out_of_patience, selected_epoch
from pipeline.train.distributed import World
from pipeline.train.labelled_drive import LabelledDrive
from pipeline.train.optimisation import autocast, warm_up_cosine
from pipeline.train.path_target import PathTarget

if TYPE_CHECKING:
    from models.steering.core.steering_net import SteeringNet

WARM_UP = 0.05  # share of the steps
TARGETS = "steering_rad", "path_1pm", "base_rad", "valid"  # arrays of a batch that are not inputs of the network
MOTION_DROPOUT = 0.5
"""Share of the runs of frames whose motion is hidden from a network that predicts ahead.

Motion alone is a good first guess, and a network that always has it learns to use the scene late or never. In these
runs it has to predict from the scene alone. docs/results.md has the effect.
"""


class Fit:
    """One training run: a network, the moving average of its weights, an optimiser, and the learning curve.

    The average is validated and selected: at a high learning rate single steps fluctuate, their mean does not.
    `best` holds the weights of the :func:`selected_epoch`.
    """

    def __init__(
        self, net: "SteeringNet", window: int, alpha: float, settings: Train, seed: int, world: World = World()
    ) -> None:
        """Prepare a run: `window` frames per prediction, loss weights exp(`alpha` |Θ|).

        The processes of a `world` share each step's runs of frames; the result equals the result of one process up to
        rounding.
        """
        self.net, self.window, self.alpha = net, window, alpha
        self.settings, self.seed, self.world = settings, seed, world
        # The same network with gradients averaged over all processes.
        self.learner: nn.Module = DistributedDataParallel(net, broadcast_buffers=False) if world.size > 1 else net
        self.average = copy.deepcopy(net)
        # Weight decay for matrices only: an offset or a time constant need not be small.
        matrices = [parameter for parameter in net.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in net.parameters() if parameter.ndim <= 1]
        groups = [{"params": matrices, "weight_decay": settings.weight_decay}, {"params": vectors, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.learning_rate, fused=True)
        self.curve: list[Epoch] = []
        self.best = copy_weights(net)

    def targets(self, target: predict.Target | PathTarget) -> reading.Targets:
        """Return the function by which the reader's processes compute a batch's targets, on the CPU."""
        dtype = next(self.net.parameters()).dtype
        return partial(step_targets, target=target, alpha=self.alpha, mirror=self.settings.mirror, dtype=dtype)

    def run(
        self,
        train: Sequence[LabelledDrive],
        val: Sequence[LabelledDrive],
        target: predict.Target | PathTarget,
        state: Path,
        metadata: Mapping[str, Any],
        title: str,
        readers: int | None = None,
    ) -> None:
        """Train until the last epoch, or until validation stops improving; results are `best` and `curve`.

        After each epoch the file `state` is written, with the run's `metadata`. If it exists, training continues from
        it, to the same result. `readers` as the workers of a Reader. Raises InputError if the loss is not finite.
        """
        self._resume(state, title)
        epochs, patience = self.settings.epochs, self.settings.patience
        with reading.Reader([*train, *val], self.window, self.net.device, self.targets(target), readers) as reader:
            read_val = partial(reader.predictions, first=len(train))
            started, before = time.perf_counter(), len(self.curve)
            while len(self.curve) < epochs and not out_of_patience(self.curve, patience):
                epoch = len(self.curve) + 1
                loss, rate = self._train(reader, train, epoch)
                if not math.isfinite(loss):
                    raise InputError(
                        f"loss of epoch {epoch} is {loss}", title, "Lower train.learning_rate or clip_norm"
                    )
                self.curve.append(Epoch(epoch, rate, loss, *self._validate(val, target, read_val)))
                selected = selected_epoch(self.curve) == epoch
                if selected:
                    self.best = copy_weights(self.average)
                if self.world.is_main:
                    checkpoint.write(state, {**metadata, **self._state(), "kind": predict.KIND, "epoch": epoch})
                eta = (time.perf_counter() - started) / (epoch - before) * (epochs - epoch)
                nmse = f", validation nmse {self.curve[-1].val_nmse:.3f}{' (selected)' if selected else ''}"
                self._log(f"{title}: {epoch} of {epochs} epochs, loss {loss:.4f}{nmse if val else ''}, ETA {eta:.0f} s")

    def _log(self, line: str) -> None:
        if self.world.is_main:
            # One write: runs in parallel share the output, and print writes the line's end separately.
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()

    def _plan(self, drives: Sequence[LabelledDrive], epoch: int) -> tuple[list[list[int]], list[reading.TrainStep]]:
        """Return the numbers of this process's runs of frames in each step, and this process's steps.

        All random numbers of an epoch derive from its number, so a resumed run equals an uninterrupted one.
        """
        settings, rng = self.settings, np.random.default_rng([self.seed, epoch])
        ahead = bool(drives[0].horizon or drives[0].ahead_m)
        spans = windows.random_spans(drives, self.window, settings.span_windows, rng)
        groups = [spans[first : first + settings.batch_spans] for first in range(0, len(spans), settings.batch_spans)]
        shares = [self.world.share(len(group)) for group in groups]
        steps = []
        for group, share in zip(groups, shares, strict=True):
            members = share or [0]  # a process without a run takes part with a run of weight 0
            factor = settings.rescale ** rng.uniform(-1, 1, len(group))[members]  # drawn for all processes' runs
            hidden = rng.random(len(group))[members] < MOTION_DROPOUT if ahead and self.net.motion else None
            steps.append(reading.TrainStep(tuple(group[run] for run in members), factor.astype(np.float32), hidden))
        return shares, steps

    def _train(self, reader: reading.Reader, drives: Sequence[LabelledDrive], epoch: int) -> tuple[float, float]:
        """Train for one epoch; return the mean loss and the last learning rate."""
        settings, device, net = self.settings, self.net.device, self.net
        loss = robust_loss if net.path else weighted_loss
        shares, steps = self._plan(drives, epoch)
        self.learner.train()
        errors, masses, rate = [], [], 0.0
        alone = multiprocessing.parent_process() is None  # several bars on one terminal overwrite each other
        hidden = not (alone and self.world.is_main and sys.stderr.isatty())
        bar = tqdm(reader.batches(steps), f"epoch {epoch}", len(steps), unit="step", leave=False, disable=hidden)
        for step, (share, batch) in enumerate(zip(shares, bar, strict=True)):
            rate = settings.learning_rate * warm_up_cosine((epoch - 1 + step / len(steps)) / settings.epochs, WARM_UP)
            for parameters in self.optimiser.param_groups:
                parameters["lr"] = rate
            # Copied before the forward pass: the copies do not wait for it.
            residual, weight = (batch[name].to(device, non_blocking=True) for name in ("residual", "weight"))
            with autocast(device, settings.precision):
                predicted = self.learner(*net.inputs(batch), pairs=settings.mirror)
            weight = weight if share else torch.zeros_like(weight)
            error = loss(predicted, residual, weight)
            # A mean over processes, as DistributedDataParallel averages gradients. Each run has a valid target, but all
            # ranges of a scaled path may be unknown: then the error is 0, too.
            mass = self.world.mean(weight.sum()).clamp_min(1e-6)
            self.optimiser.zero_grad(set_to_none=True)
            (error / mass).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(net.parameters(), settings.clip_norm)
            self.optimiser.step()
            decay = settings.average if step or epoch > 1 else 0.0  # starts with the weights after the first step
            with torch.no_grad():
                torch._foreach_lerp_([*self.average.parameters()], [*net.parameters()], 1 - decay)
            errors.append(error.detach())
            masses.append(mass)
        error_sum, mass_sum = self.world.mean(torch.stack(errors + masses).double().view(2, -1).sum(1)).tolist()
        return error_sum / mass_sum, rate

    def _validate(
        self, drives: Sequence[LabelledDrive], target: predict.Target | PathTarget, read: Any
    ) -> tuple[float, float]:
        """Return MSE in rad² and nmse of the averaged weights; NaN without drives, the MSE also for a path."""
        if not drives:
            return math.nan, math.nan
        if isinstance(target, PathTarget):
            predictions = predict.predict_drives(self.average, drives, self.window, target, self.world, read=read)
            return math.nan, target.nmse(drives, predictions)
        steering, error, _ = self._predict(drives, target, read)
        mse, zero = float(np.mean(error**2)), float(np.mean(steering**2))
        return mse, mse / zero if zero > 0 else math.nan

    def calibrate(
        self, drives: Sequence[LabelledDrive], target: predict.Target | PathTarget
    ) -> predict.Target | PathTarget:
        """Return the target with the scale of σ and the 95 % interval fitted to the drives' errors; best weights.

        Training errors are smaller than those on new drives, so σ fitted to them is too small.
        """
        self.average.load_state_dict(self.best)
        if isinstance(target, PathTarget):
            return target.calibrated(
                drives, predict.predict_drives(self.average, drives, self.window, target, self.world)
            )
        _, error, sigma = self._predict(drives, target)
        ratio = np.abs(error) / sigma
        factor = np.sqrt(np.mean(ratio**2))
        return replace(target, sigma_factor=float(factor), interval_95=float(np.quantile(ratio, 0.95) / factor))

    def _predict(self, drives: Sequence[LabelledDrive], target: predict.Target, read: Any = None) -> np.ndarray:
        """Return Θ, its error, and σ (NaN without uncertainty) of the valid frames with a prediction, [3,N] in rad."""
        columns = []
        predictions = predict.predict_drives(self.average, drives, self.window, target, self.world, read=read)
        for drive, predicted in zip(drives, predictions, strict=True):
            error, sigma = predicted.steering_rad - drive.steering_rad, predicted.sigma_rad
            rows = np.stack([drive.steering_rad, error, np.full(len(error), np.nan) if sigma is None else sigma])
            columns.append(rows[:, drive.valid & ~np.isnan(error)])
        return np.concatenate(columns, axis=1)

    def _resume(self, path: Path, title: str) -> None:
        """Load the state of an interrupted run, if the main process has one."""
        with error_context(fix=f"Delete {path} to start again"):
            stored = checkpoint.read(path, predict.KIND) if self.world.is_main and path.is_file() else None
            state = self.world.gather(stored)[0]  # other machines may not share the file
            if not state:
                return
            self.net.load_state_dict(state["net"])
            self.average.load_state_dict(state["average"])
            self.optimiser.load_state_dict(state["optimiser"])
            self.best, self.curve = state["best"], [Epoch(**row) for row in state["curve"]]
        self._log(f"{title}: continues after epoch {len(self.curve)} of {self.settings.epochs}")

    def _state(self) -> dict[str, Any]:
        return {
            "net": copy_weights(self.net),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best": self.best,
            "curve": [asdict(row) for row in self.curve],
        }


def copy_weights(net: nn.Module) -> dict[str, Tensor]:
    """Return a copy of the network's tensors on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}


def step_targets(
    batch: Mapping[str, Tensor], target: predict.Target | PathTarget, alpha: float, mirror: bool, dtype: torch.dtype
) -> dict[str, Tensor]:
    """Return `residual`, the outputs that the network should have, and their `weight` in the loss, both [W] or [W,R].

    With `mirror` those of the mirrored windows follow.
    """
    arrays = {name: batch[name].to(dtype) for name in TARGETS if name in batch}
    residual, weight = target.residual(arrays), arrays["valid"]
    if isinstance(target, predict.Target):
        weight = weight * torch.exp(alpha * arrays["steering_rad"].abs())
    if mirror:
        residual, weight = torch.cat([residual, -residual]), torch.cat([weight, weight])
    return {"residual": residual, "weight": weight}


def weighted_loss(predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Return Σ w (Θ̂ - Θ)² over windows [W]: paper eq. 9 when divided by Σ w.

    With `predicted` [W,2], Θ̂ and log σ, Σ w (log σ + (Θ̂ - Θ)² / 2σ²) is added for σ alone: the negative log-likelihood
    up to a constant. As the loss of Θ̂, it gives hard windows a large σ instead of learning them.
    """
    if predicted.ndim == 1:
        return (weight * nn.functional.mse_loss(predicted, target, reduction="none")).sum()
    mean, log_sigma = predicted.unbind(1)
    error = mean - target
    likelihood = log_sigma + (error.detach() * torch.exp(-log_sigma)).square() / 2
    return (weight * (error.square() + likelihood)).sum()


def robust_loss(predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Return Σ w Huber(κ̂ - κ) over windows and ranges [W,R], standardised: linear beyond one standard deviation.

    The path at a junction is the driver's choice, and squared errors there would dominate. With `predicted` [W,2R],
    κ̂ and log σ, Σ w (log σ + Huber((κ̂ - κ) / σ)) is added for σ alone, as in :func:`weighted_loss`.
    """
    huber = partial(nn.functional.huber_loss, reduction="none")
    if predicted.shape == target.shape:
        return (weight * huber(predicted, target)).sum()
    mean, log_sigma = predicted.chunk(2, dim=1)
    scale = torch.exp(-log_sigma)
    likelihood = log_sigma + huber(mean.detach() * scale, target * scale)
    return (weight * (huber(mean, target) + likelihood)).sum()
