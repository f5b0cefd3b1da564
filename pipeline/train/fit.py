"""Fit one steering network to the training drives, with early stopping and resume."""

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core.steering_net import SteeringNet
from pipeline.base import checkpoint
from pipeline.base.errors import InputError, error_context
from pipeline.base.loop import warm_up_cosine
from pipeline.train import trained, windows
from pipeline.train.entry import Entry
from pipeline.train.frames import Files
from pipeline.train.loss import Scale, mean_nmse, step_targets, weighted_loss
from pipeline.train.settings import Train
from pipeline.train.targets import LabelledDrive

# kind and modules of a resumable training
STATE, PARTS = "state of training", ("net", "average", "optimiser")
WARM_UP = 0.05  # share of the steps
SMOOTHING = 3  # epochs
# Share of the spans whose motion is hidden from a network that predicts ahead. Motion alone is a
# good first guess: a network that always has it learns to use the scene late or never.
MOTION_DROPOUT = 0.5


def selected_epoch(curve: Sequence[Mapping[str, float]]) -> int:
    """Return the number of the epoch of a learning curve whose weights are kept; the last one
    without validation.

    It has the lowest mean of the errors of this epoch and the two before, since one epoch's error
    is noisy.
    """
    errors = [row["val_nmse"] for row in curve]
    means = {
        end: np.mean(errors[max(0, end - SMOOTHING) : end]) for end in range(1, len(errors) + 1)
    }
    return min(
        (end for end in means if np.isfinite(means[end])),
        key=means.__getitem__,
        default=len(errors),
    )


@dataclass
class Fit:
    """One training run: a network, the moving average of its weights, an optimiser, and the
    learning curve.

    The average, with the network's buffers, is validated and selected: single steps fluctuate at a
    high learning rate.
    """

    net: SteeringNet
    entry: Entry
    settings: Train
    seed: int
    train: Sequence[LabelledDrive]
    val: Sequence[LabelledDrive]
    files: Files = field(default_factory=Files)

    def __post_init__(self) -> None:
        self.scale = Scale.from_drives(self.train)
        device, dtype = self.net.device, next(self.net.parameters()).dtype
        self._gain, self._std = (
            torch.from_numpy(v).to(device, dtype) for v in (self.scale.gain, self.scale.std)
        )
        # the frames of a single step are too few
        self.net.scale.momentum = min(0.1, 1 - self.settings.average)
        self.average = copy.deepcopy(self.net)
        self.best = copy_weights(self.net)
        # Weight decay for matrices only: an offset or a time constant need not be small.
        matrices = [parameter for parameter in self.net.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in self.net.parameters() if parameter.ndim <= 1]
        decay = self.settings.weight_decay
        groups = [
            {"params": matrices, "weight_decay": decay},
            {"params": vectors, "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=self.settings.learning_rate, fused=True)
        # epoch, learning_rate, train_loss, val_nmse (NaN without validation)
        self.curve: list[dict[str, float]] = []

    def run(self, state: Path, title: str) -> None:
        """Train until the last epoch, or until validation stops improving.

        Results are `best`, the weights of the selected epoch, `curve` and `scale`. After each epoch
        the file `state` is written. If it exists, training continues from it, to the same result.
        """
        epochs = self.settings.epochs
        if state.is_file():
            with error_context(fix=f"Delete {state} to start again"):
                content = checkpoint.read(state, STATE)
            for name in PARTS:
                getattr(self, name).load_state_dict(content[name])
            self.best, self.curve = content["best"], content["curve"]
            after = f"continues after epoch {len(self.curve)} of {epochs}"
            print(
                f"{title}: {after if self._unfinished() else 'kept from an earlier run'}",
                flush=True,
            )
        train, val = (
            windows.Reader(drives, self.entry.window, self.files)
            for drives in (self.train, self.val)
        )
        if self._unfinished():
            self.files.load(self.net.device, self._peak)
        started, before = time.perf_counter(), len(self.curve)
        while self._unfinished():
            epoch = len(self.curve) + 1
            loss, rate = self._train(train, epoch)
            if not math.isfinite(loss):
                problem = f"loss of epoch {epoch} is {loss}"
                raise InputError(problem, title, "Lower train.learning_rate or clip_norm")
            error = math.nan
            if self.val:
                error = mean_nmse(self.val, trained.predict_drives(self.average, val, self.scale))
            self.curve.append(
                {"epoch": epoch, "learning_rate": rate, "train_loss": loss, "val_nmse": error}
            )
            if selected := selected_epoch(self.curve) == epoch:
                self.best = copy_weights(self.average)
            parts = {name: getattr(self, name).state_dict() for name in PARTS}
            checkpoint.write(
                state, {"kind": STATE, **parts, "best": self.best, "curve": self.curve}
            )
            eta = (time.perf_counter() - started) / (epoch - before) * (epochs - epoch)
            text = (
                f", validation nmse {error:.3f}{' (selected)' if selected else ''}"
                if self.val
                else ""
            )
            print(
                f"{title}: {epoch} of {epochs} epochs, loss {loss:.4f}{text}, ETA {eta:.0f} s",
                flush=True,
            )
        if before < (done := len(self.curve)) < epochs:
            chosen = selected_epoch(self.curve)
            after = f"{done - chosen} epochs after the least validation error, epoch {chosen}"
            print(f"{title}: stopped {after}", flush=True)

    def _unfinished(self) -> bool:
        done = len(self.curve)
        return (
            done < self.settings.epochs
            and done - selected_epoch(self.curve) < self.settings.patience
        )

    def _plan(self, epoch: int) -> list[list[windows.Span]]:
        """Return the spans of each step of an epoch."""
        # All random numbers of an epoch derive from its number, so a resumed run equals an
        # uninterrupted one.
        settings, rng = self.settings, np.random.default_rng([self.seed, epoch])
        window = self.entry.window
        spans = windows.spans(self.train, window, settings.span_windows, rng)
        spans = [
            span
            for span in spans
            if self.train[span.drive].has_target(span.start + window - 1, span.stop)
        ]
        rng.shuffle(spans)
        factor = (settings.rescale ** rng.uniform(-1, 1, len(spans))).astype(np.float32).tolist()
        # Without the scene, an equivariant network without motion has the output 0 and no gradient.
        hides = (
            (self.entry.horizon or self.entry.predict == "path")
            and self.net.motion
            and self.net.sees
        )
        hidden = (rng.random(len(spans)) < MOTION_DROPOUT * bool(hides)).tolist()
        spans = [
            replace(span, factor=f, hidden=h)
            for span, f, h in zip(spans, factor, hidden, strict=True)
        ]
        # About equally many, as the features of a single frame have no variance.
        parts = np.array_split(np.arange(len(spans)), -(-len(spans) // settings.batch_spans))
        return [[spans[row] for row in part] for part in parts]

    def _train(self, reader: windows.Reader, epoch: int) -> tuple[float, float]:
        """Train for one epoch; return the mean loss and the last learning rate."""
        settings, device, net = self.settings, self.net.device, self.net
        steps = self._plan(epoch)
        net.train()
        # of dropout, see _plan
        torch.manual_seed(int(np.random.SeedSequence([self.seed, epoch]).generate_state(1)[0]))
        errors, weight_sums = [], []
        for step, batch in enumerate(reader.batches(steps, device)):
            progress = (epoch - 1 + step / len(steps)) / settings.epochs
            for parameters in self.optimiser.param_groups:
                parameters["lr"] = settings.learning_rate * warm_up_cosine(progress, WARM_UP)
            error, weight_sum = self._error(net, batch)
            self.optimiser.zero_grad(set_to_none=True)
            (error / weight_sum).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(net.parameters(), settings.clip_norm)
            self.optimiser.step()
            self._update_average(first=epoch == 1 and step == 0)
            errors.append(error.detach())
            weight_sums.append(weight_sum)
        error, weight = torch.stack(errors + weight_sums).double().view(2, -1).sum(1).tolist()
        return error / weight, self.optimiser.param_groups[0]["lr"]

    def _error(self, net: SteeringNet, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the loss of a batch before it is divided by the sum of the weights, and this
        sum.
        """
        residual, weight = step_targets(batch, self._gain, self._std, self.entry.alpha)
        error = weighted_loss(
            net(*net.inputs(batch)), residual, weight, self.entry.predict == "path"
        )
        # Each span has a valid target, but all ranges of a scaled path may be unknown: then the
        # error is 0, too.
        return error, weight.sum().clamp_min(1e-6)

    @torch.no_grad()
    def _update_average(self, first: bool) -> None:
        """Move the averaged parameters towards the network's; the first time, and buffers always,
        copy them.
        """
        weight = 1.0 if first else 1 - self.settings.average
        torch._foreach_lerp_((*self.average.parameters(),), (*self.net.parameters(),), weight)
        torch._foreach_copy_((*self.average.buffers(),), (*self.net.buffers(),))

    def _peak(self) -> int:
        """Return the bytes on the GPU of the largest step and of the largest batch of a
        validation.
        """
        torch.cuda.empty_cache()
        reader = windows.Reader([*self.train, *self.val], self.entry.window, self.files)
        net, before = copy.deepcopy(self.net), torch.cuda.memory_reserved()
        tested = windows.spans(reader.timelines, self.entry.window, trained.WINDOWS)
        steps = self._plan(1), [[span] for span in tested]
        step, batch = (
            max(part, key=lambda group: sum(span.stop - span.start for span in group))
            for part in steps
        )
        torch.cuda.reset_peak_memory_stats()
        # Twice, as the first step's error and graph live until the second has its own.
        for arrays, training in zip(
            reader.batches([step, step, batch], net.device), (True, True, False), strict=True
        ):
            with torch.set_grad_enabled(training):
                error, weight_sum = self._error(net.train(training), arrays)
            if training:
                (error / weight_sum).backward()  # type: ignore[no-untyped-call]
        return torch.cuda.max_memory_reserved() - before


def copy_weights(net: nn.Module) -> dict[str, Tensor]:
    """Return a copy of the network's tensors on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}
