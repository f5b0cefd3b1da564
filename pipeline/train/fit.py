"""Fit one steering network to the training drives, with early stopping and resume."""

import copy
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from pipeline.train.loss import Scale, batch_targets, mean_nmse, weighted_loss
from pipeline.train.settings import Train
from pipeline.train.targets import LabelledDrive

# Kind of the checkpoint of a training that can be resumed.
STATE = "state of training"
# Fields of :class:`Fit` whose ``state_dict`` is saved after each epoch.
PARTS = ("net", "average", "optimiser")
# Share of the steps in which the learning rate rises.
WARM_UP = 0.05
# Number of epochs over which the validation error is averaged to select an epoch.
SMOOTHING = 3
# Share of the spans whose motion is hidden from a network that predicts ahead. Motion alone is a
# good first guess: a network that always has it learns to use the scene late or never. The nmse a
# second ahead was 0.264 and 0.179 with motion always (seeds 0 and 1), 0.087 with 0.3 of the spans
# hidden (seed 0), and 0.077 and 0.100 with half of them: docs/history.md.
MOTION_DROPOUT = 0.5
# Function that yields the batches of an epoch, given its number and its number of steps, and says
# how many are done.
Watch = Callable[[Iterable[dict[str, Tensor]], int, int], Iterable[dict[str, Tensor]]]


def selected_epoch(curve: Sequence[Mapping[str, float]]) -> int:
    """Return the number of the epoch of a learning curve whose weights are kept.

    This epoch has the lowest validation error. Each error is averaged with those of the two epochs
    before, since the error of a single epoch is noisy. Without validation, the last epoch is kept.
    """
    errors = [row["val_nmse"] for row in curve]
    selected = len(errors)
    least = math.inf
    for epoch in range(1, len(errors) + 1):
        mean = float(np.mean(errors[max(0, epoch - SMOOTHING) : epoch]))
        if mean < least:
            selected = epoch
            least = mean
    return selected


@dataclass
class Fit:
    """One training run: a network, the average of its weights, an optimiser, and a learning curve.

    The averaged weights, with the network's buffers, are validated and kept, because the weights
    fluctuate from step to step at a high learning rate.
    """

    net: SteeringNet
    entry: Entry
    settings: Train
    seed: int
    train: Sequence[LabelledDrive]
    val: Sequence[LabelledDrive]
    files: Files = field(default_factory=Files)
    watch: Watch | None = None

    def __post_init__(self) -> None:
        self.scale = Scale.from_drives(self.train)
        dtype = next(self.net.parameters()).dtype
        self._gain = torch.from_numpy(self.scale.gain).to(self.net.device, dtype)
        self._offset = torch.from_numpy(self.scale.offset).to(self.net.device, dtype)
        self._std = torch.from_numpy(self.scale.std).to(self.net.device, dtype)

        # The mean and variance of features are averaged over steps, too, since a single step has
        # too few frames.
        self.net.scale.momentum = min(0.1, 1 - self.settings.average)
        self.average = copy.deepcopy(self.net)
        self.best = copy_weights(self.net)

        # Weight decay for matrices only: an offset or a time constant need not be small.
        matrices = [parameter for parameter in self.net.parameters() if parameter.ndim > 1]
        vectors = [parameter for parameter in self.net.parameters() if parameter.ndim <= 1]
        groups = [
            {"params": matrices, "weight_decay": self.settings.weight_decay},
            {"params": vectors, "weight_decay": 0.0},
        ]
        self.optimiser = torch.optim.AdamW(groups, lr=self.settings.learning_rate, fused=True)

        # A row per epoch: epoch, learning_rate, train_loss, val_nmse (NaN without validation).
        self.curve: list[dict[str, float]] = []

    def train_network(self, state: Path, title: str) -> None:
        """Train until the last epoch, or until validation stops improving.

        Results are `best`, the weights of the selected epoch, `curve` and `scale`. After each epoch
        the file `state` is written. If it exists, training continues from it, to the same result.
        """
        epochs = self.settings.epochs
        if state.is_file():
            self._resume_training(state, title)
        train = windows.Reader(self.train, self.entry.window, self.files)
        val = windows.Reader(self.val, self.entry.window, self.files)
        if self._is_unfinished():
            self.files.load_frames(self.net.device)

        before = len(self.curve)
        started = time.perf_counter()
        while self._is_unfinished():
            epoch = len(self.curve) + 1
            loss, rate = self._train_epoch(train, epoch)
            if not math.isfinite(loss):
                problem = f"loss of epoch {epoch} is {loss}"
                fix = "Lower train.learning_rate or clip_norm, or look for a division by 0"
                raise InputError(problem, title, fix)

            error = math.nan
            if self.val:
                with error_context(f"{title}: validation of epoch {epoch}"):
                    predictions = trained.predict_drives(self.average, val, self.scale)
                error = mean_nmse(self.val, predictions)
            row = {"epoch": epoch, "learning_rate": rate, "train_loss": loss, "val_nmse": error}
            self.curve.append(row)
            selected = selected_epoch(self.curve) == epoch
            if selected:
                self.best = copy_weights(self.average)
            self._save_state(state)

            text = f"{title}: {epoch} of {epochs} epochs, loss {loss:.4f}"
            if self.val:
                text += f", validation nmse {error:.3f}"
                if selected:
                    text += " (selected)"
            eta_s = (time.perf_counter() - started) / (epoch - before) * (epochs - epoch)
            print(f"{text}, ETA {eta_s:.0f} s", flush=True)

        # Say that training stopped early, unless an earlier run has said it.
        done = len(self.curve)
        if before < done < epochs:
            chosen = selected_epoch(self.curve)
            after = f"{done - chosen} epochs after the least validation error, epoch {chosen}"
            print(f"{title}: stopped {after}", flush=True)

    def _is_unfinished(self) -> bool:
        """Return whether epochs remain, and validation has improved in the last `patience`."""
        done = len(self.curve)
        waited = done - selected_epoch(self.curve)
        return done < self.settings.epochs and waited < self.settings.patience

    def _resume_training(self, state: Path, title: str) -> None:
        """Continue from the file of an earlier run. Raises InputError if it is damaged."""
        with error_context(fix=f"Delete {state} to start again"):
            content = checkpoint.read(state, STATE)
        for name in PARTS:
            getattr(self, name).load_state_dict(content[name])
        self.best = content["best"]
        self.curve = content["curve"]
        text = "kept from an earlier run"
        if self._is_unfinished():
            text = f"continues after epoch {len(self.curve)} of {self.settings.epochs}"
        print(f"{title}: {text}", flush=True)

    def _save_state(self, state: Path) -> None:
        """Write the file that :meth:`_resume_training` reads."""
        parts = {name: getattr(self, name).state_dict() for name in PARTS}
        checkpoint.write(state, {"kind": STATE, **parts, "best": self.best, "curve": self.curve})

    def _plan_epoch(self, epoch: int) -> list[list[windows.Span]]:
        """Return the spans of each step of an epoch."""
        # All random numbers of an epoch derive from its number, so a resumed run equals an
        # uninterrupted one.
        rng = np.random.default_rng([self.seed, epoch])
        spans = []
        for span in windows.split_spans(
            self.train, self.entry.window, self.settings.span_windows, rng
        ):
            first_end = span.start + self.entry.window - 1
            if self.train[span.drive].has_target(first_end, span.stop):
                spans.append(span)
        rng.shuffle(spans)

        # Motion is not hidden from a network that sees no frames: it would have no input, and an
        # equivariant network without input has the output 0 and no gradient.
        dropout = 0.0
        if self.entry.predicts_ahead and self.net.motion and self.net.sees_frames:
            dropout = MOTION_DROPOUT

        # Scale the world of each span by a random factor, and hide the motion of some spans.
        factors = (self.settings.rescale ** rng.uniform(-1, 1, len(spans))).astype(np.float32)
        hidden = rng.random(len(spans)) < dropout
        augmented = []
        for span, factor, is_hidden in zip(spans, factors.tolist(), hidden.tolist(), strict=True):
            augmented.append(replace(span, factor=factor, hidden=is_hidden))

        # All steps have about equally many spans. A remainder with a single frame would be a step
        # in which features have no variance.
        steps = math.ceil(len(spans) / self.settings.batch_spans)
        groups = np.array_split(np.array(augmented, dtype=object), steps)
        return [group.tolist() for group in groups]

    def _train_epoch(self, reader: windows.Reader, epoch: int) -> tuple[float, float]:
        """Train for one epoch; return the mean loss and the last learning rate."""
        net = self.net
        net.train()
        steps = self._plan_epoch(epoch)
        # Random numbers of the network, such as those of dropout, derive from the epoch, too.
        torch.manual_seed(int(np.random.SeedSequence([self.seed, epoch]).generate_state(1)[0]))
        batches: Iterable[dict[str, Tensor]] = reader.read_batches(steps, net.device)
        if self.watch:
            batches = self.watch(batches, epoch, len(steps))
        errors = []
        weights = []
        for step, batch in enumerate(batches):
            progress = (epoch - 1 + step / len(steps)) / self.settings.epochs
            learning_rate = self.settings.learning_rate * warm_up_cosine(progress, WARM_UP)
            for group in self.optimiser.param_groups:
                group["lr"] = learning_rate

            error, weight = self._batch_error(net, batch)
            self.optimiser.zero_grad(set_to_none=True)
            # All targets of a step may be unknown. Then the minimum avoids 0 / 0.
            (error / weight.clamp_min(1e-6)).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(net.parameters(), self.settings.clip_norm)
            self.optimiser.step()
            self._update_average(first=epoch == 1 and step == 0)
            errors.append(error.detach())
            weights.append(weight)

        # The sums of errors and weights are read once per epoch, so that no step waits for a GPU.
        sums = torch.stack(errors + weights).double().view(2, -1).sum(1)
        error_sum, weight_sum = sums.tolist()
        if not weight_sum:
            problem = f"no target of epoch {epoch} is known after the scene is scaled"
            fix = "Set train.rescale: 1, or let labels.ahead_m begin at 0"
            raise InputError(problem, self.entry.predict, fix)
        return error_sum / weight_sum, learning_rate

    def _batch_error(self, net: SteeringNet, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the weighted sum of a batch's errors, and the sum of the weights."""
        residual, weight = batch_targets(
            batch, self._gain, self._offset, self._std, self.entry.alpha
        )
        output = net(*net.inputs(batch))
        robust = self.train[0].quantity.is_robust
        error = weighted_loss(output, residual, weight, robust=robust)
        return error, weight.sum()

    @torch.no_grad()
    def _update_average(self, first: bool) -> None:
        """Move the averaged parameters towards those of the network.

        In the first step, parameters are copied. Buffers are copied in every step.
        """
        weight = 1.0 if first else 1 - self.settings.average
        torch._foreach_lerp_([*self.average.parameters()], [*self.net.parameters()], weight)
        torch._foreach_copy_([*self.average.buffers()], [*self.net.buffers()])


def copy_weights(net: nn.Module) -> dict[str, Tensor]:
    """Return a copy of the network's tensors on the CPU."""
    return {name: tensor.detach().cpu().clone() for name, tensor in net.state_dict().items()}
