"""Fit a steering network to the training drives: epochs, early stopping on validation, state saved for a resume."""

import math
import multiprocessing
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import tqdm

from pipeline.base.errors import InputError, error_context
from pipeline.fitting import checkpoint
from pipeline.fitting.precision import autocast
from pipeline.fitting.schedule import warm_up_cosine
from pipeline.sections.train import Train
from pipeline.train import predict, reading, score, windows
from pipeline.train.augment import Change
from pipeline.train.curve import Epoch, kept_epoch, out_of_patience
from pipeline.train.distributed import World

WARM_UP = 0.05  # share of the steps in which the learning rate rises
SHOWN = 0.02  # of an epoch's time; the network waits for less now and then


class Fit:
    """One training run: a network, the moving average of its weights, an optimiser, and the epochs so far.

    The average is what is validated and kept: single steps at a high learning rate jump about, their mean does not.
    `best` is that of the epoch which `settings.keep` chooses.
    """

    def __init__(
        self,
        net: nn.Module,
        forward: predict.Forward,
        window: int,
        alpha: float,
        settings: Train,
        seed: int,
        world: World = World(),
    ) -> None:
        """Letters as in the model's line: `window` frames per prediction, loss weights exp(`alpha` |Θ|).

        The processes of a `world` share each step's runs; the result is that of one process, up to rounding.
        """
        self.net, self.forward, self.window, self.alpha = net, forward, window, alpha
        self.settings, self.seed, self.world = settings, seed, world
        # What learns: the same network, but that its gradients are the mean over all processes.
        self.learner: nn.Module = DistributedDataParallel(net, broadcast_buffers=False) if world.size > 1 else net
        self.device = next(net.parameters()).device
        self.average = AveragedModel(net, multi_avg_fn=get_ema_multi_avg_fn(settings.average))  # type: ignore[no-untyped-call]
        # Decay pulls matrices towards zero; an offset or a time constant has no reason to be small.
        matrices = [parameter for parameter in net.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in net.parameters() if parameter.ndim <= 1]
        groups = [{"params": matrices, "weight_decay": settings.weight_decay}, {"params": vectors, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=settings.learning_rate)
        self.curve: list[Epoch] = []
        self.best = copy_of(net)

    def run(
        self,
        train: Sequence[windows.Drive],
        val: Sequence[windows.Drive],
        kept: Path,
        about: Mapping[str, Any],
        title: str,
    ) -> None:
        """Train until the last epoch, or until validation no longer improves; `best` and `curve` are the result.

        After each epoch the state goes to `kept`, beside what `about` says of the run; if that file exists, training
        goes on from there, to the same result. Raises InputError if the loss is no longer finite.
        """
        epochs = self.settings.epochs
        with error_context(fix=f"Delete {kept} to start again"):
            own = checkpoint.read(kept, predict.KIND) if self.world.leads and kept.is_file() else None
            state = self.world.gather(own)[0]  # the others may be on machines that do not see the file
            if state:
                self._load(state)
        if state:
            self._say(f"{title}: {len(self.curve)} of {epochs} epochs kept from the run before")
        if self.alpha:
            count, effective = sum(int(drive.valid.sum()) for drive in train), effective_frames(train, self.alpha)
            self._say(f"{title}: weighted by alpha {self.alpha:g}, {count} frames count as {effective:.0f}")
        target, keep = predict.Target.of(train), self.settings.keep
        steps = reading.Steps(train, self.window, self.settings.noise)
        with reading.Reader(steps, self.device) as reader:
            started, before = time.perf_counter(), len(self.curve)
            while len(self.curve) < epochs and not out_of_patience(self.curve, keep, self.settings.patience):
                epoch, began = len(self.curve) + 1, time.perf_counter()
                loss, rate = self._train(reader, train, target, epoch)
                waited = reader.waited_s / (time.perf_counter() - began)
                if not math.isfinite(loss):
                    raise InputError(
                        f"{title}: the loss of epoch {epoch} is {loss}: lower train.learning_rate or clip_norm"
                    )
                self.curve.append(Epoch(epoch, rate, loss, *self._validate(val, target)))
                better = kept_epoch(self.curve, keep) == epoch
                if better:
                    self.best = copy_of(self.average.module)
                if self.world.leads:
                    checkpoint.write(kept, {**about, **self._state(), "kind": predict.KIND, "epoch": epoch})
                eta = (time.perf_counter() - started) / (epoch - before) * (epochs - epoch)
                nmse = f", validation nmse {self.curve[-1].val_nmse:.3f}{' (kept)' if better else ''}" if val else ""
                reads = f", {waited:.0%} of it waiting for data" if waited > SHOWN else ""
                self._say(f"{title}: epoch {epoch}/{epochs}, loss {loss:.4f}{nmse}, {eta:.0f} s to go{reads}")

    def _say(self, line: str) -> None:
        if self.world.leads:
            # In one piece: runs side by side share the output, and an unbuffered print writes the line's end by itself.
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()

    def _plan(self, drives: Sequence[windows.Drive], epoch: int) -> tuple[list[list[int]], list[reading.Step]]:
        """Return which of each step's runs are this process's, and this process's steps.

        Everything random in an epoch follows from its number: a resumed run goes on as if it had never stopped.
        """
        settings, rng = self.settings, np.random.default_rng([self.seed, epoch])
        spans = windows.random_spans(drives, self.window, settings.run_windows, rng)
        groups = [spans[first : first + settings.batch_runs] for first in range(0, len(spans), settings.batch_runs)]
        shares = [self.world.share(len(group)) for group in groups]
        steps = []
        for number, (group, share) in enumerate(zip(groups, shares, strict=True)):
            own = share or [0]  # a process without a run of its own takes part with one that counts nothing
            change = Change.draw(len(group), settings, rng).of(own)  # drawn for all processes' runs
            first = 1 + number * settings.batch_runs  # from 1: zeros at the end of a seed are as if they were not there
            seeds = tuple((self.seed, epoch, first + run) for run in own)
            steps.append(reading.Step(tuple(group[run] for run in own), change, seeds))
        return shares, steps

    def _train(
        self, reader: reading.Reader, drives: Sequence[windows.Drive], target: predict.Target, epoch: int
    ) -> tuple[float, float]:
        settings = self.settings
        shares, steps = self._plan(drives, epoch)
        self.learner.train()
        total, rate = torch.zeros(2, dtype=torch.float64, device=self.device), 0.0  # sums of weight · error², weight
        alone = multiprocessing.parent_process() is None  # several bars on one terminal draw over each other
        hidden = not (alone and self.world.leads and sys.stderr.isatty())
        bar = tqdm(reader.batches(steps), f"epoch {epoch}", len(steps), unit="step", leave=False, disable=hidden)
        for step, (share, batch) in enumerate(zip(shares, bar, strict=True)):
            rate = settings.learning_rate * warm_up_cosine((epoch - 1 + step / len(steps)) / settings.epochs, WARM_UP)
            for parameters in self.optimiser.param_groups:
                parameters["lr"] = rate
            with autocast(self.device, settings.precision):
                predicted = self.forward(self.learner, batch)
            steering = batch["steering_rad"].to(predicted)
            weight = batch["valid"].to(predicted) * torch.exp(self.alpha * steering.abs())
            weight = weight if share else torch.zeros_like(weight)
            mass = self.world.sum(weight.sum())
            left_open = steering - batch["base_rad"].to(predicted)
            error = weighted_error(predicted, left_open / target.std_rad, weight)
            self.optimiser.zero_grad(set_to_none=True)
            # The learner averages over the processes; their errors add up.
            (error * self.world.size / mass.clamp_min(torch.finfo(mass.dtype).tiny)).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.net.parameters(), settings.clip_norm)
            self.optimiser.step()
            self.average.update_parameters(self.net)
            total += torch.stack([error.detach(), weight.sum()])
        error_sum, weight_sum = self.world.sum(total).tolist()
        return error_sum / weight_sum, rate

    def _validate(self, drives: Sequence[windows.Drive], target: predict.Target) -> tuple[float, float]:
        if not drives:
            return math.nan, math.nan
        predicted = np.concatenate(
            predict.over_drives(self.average.module, self.forward, drives, self.window, target, self.world)
        )
        steering = np.concatenate([drive.steering_rad for drive in drives])
        judged = np.concatenate([drive.valid for drive in drives]) & ~np.isnan(predicted)
        steering, predicted = steering[judged], predicted[judged]
        return score.mse(steering, predicted), score.nmse(steering, predicted)

    def _state(self) -> dict[str, Any]:
        return {
            "net": copy_of(self.net),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best": self.best,
            "curve": [asdict(row) for row in self.curve],
        }

    def _load(self, state: Mapping[str, Any]) -> None:
        self.net.load_state_dict(state["net"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.best, self.curve = state["best"], [Epoch(**row) for row in state["curve"]]


def copy_of(net: nn.Module) -> dict[str, Tensor]:
    """Return the network's tensors as they are now, on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}


def effective_frames(drives: Sequence[windows.Drive], alpha: float) -> float:
    """Return (Σw)² / Σw² of the loss weights w = exp(alpha |Θ|) over the valid frames (Kish's effective sample size).

    As many frames of equal weight would say as much; a large alpha leaves the loss to a few.
    """
    bend = np.abs(np.concatenate([drive.steering_rad[drive.valid] for drive in drives]))
    weight = np.exp(alpha * (bend - bend.max()))  # the factor cancels, and nothing overflows
    return float(weight.sum() ** 2 / (weight**2).sum())


def weighted_error(predicted: Tensor, wanted: Tensor, weight: Tensor) -> Tensor:
    """Σ w (Θ̂ - Θ)² over windows [W]: paper eq. 9 once divided by Σ w."""
    return (weight * (predicted - wanted).square()).sum()
