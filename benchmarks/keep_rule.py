"""Which epoch's weights to keep: the rules of `train.keep`, judged by validation drives that did not choose.

A seed is trained once, and every validation drive is judged after each epoch. Then, for each half of these drives, each
rule chooses an epoch by that half, and its error on the other half counts. Test drives are not read.
"""

import contextlib
import math
import multiprocessing
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.params import load, load_entry
from pipeline.report.tables import markdown
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import fit, frames, predict, windows
from pipeline.train.curve import Epoch, kept_epoch

RULES: tuple[str, ...] = get_args(Train.model_fields["keep"].annotation)
BY_CHANCE = "the best of all epochs"  # by the judging half itself: what no rule can beat


def main(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="an entry of models: in the params file")],
    data: Annotated[Path, typer.Option(help="holds graphs/ and labels/")] = Path("data"),
    params: Path = Path("params.yaml"),
    seeds: Annotated[int, typer.Option(min=2)] = 5,
    epochs: Annotated[int, typer.Option(min=3)] = 8,
    workers: int | None = None,
) -> None:
    """Train a model's seeds, apply each rule, and print a Markdown table."""
    with contextlib.redirect_stdout(sys.stderr):
        work = partial(errors, model=model, data=data, params=params, epochs=epochs)
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(
            min(workers or console.default_workers(), seeds), mp_context=context, initializer=_start
        ) as pool:
            squares = list(pool.map(work, range(seeds)))
    print(table([judged(each) for each in squares], epochs))


def errors(seed: int, model: str, data: Path, params: Path, epochs: int) -> np.ndarray:
    """Train one seed; return the sums of squared errors and of squared labels, [epoch, validation drive, 2]."""
    import torch

    from models.steering.core import steering_net

    line = load_entry(Model, "models", model, params)
    settings = load(Train, params)
    changed = {"epochs": epochs, "patience": epochs, "learning_rate": line.learning_rate or settings.learning_rate}
    variant = data / "graphs" / line.input
    splits = store.read_index(variant, stage="graphs")
    train, val = (
        windows.read_drives(
            variant, data / "labels", store.of_split(splits, split), line.window, line.horizon, line.motion
        )
        for split in ("train", "val")
    )
    if len(val) < 2:
        raise InputError(f"{variant} has {len(val)} validation drives: half of them choose, half judge, so take more")
    torch.manual_seed(seed)
    net = steering_net.build(steering_net.resolved(line.model_dump()), **frames.contents(train[0].graphs))
    fitting = Watched(net, steering_net.predict, line.window, line.alpha, settings.model_copy(update=changed), seed)
    with tempfile.TemporaryDirectory() as scratch:
        fitting.run(train[: line.roads], val, Path(scratch) / "state.pt", {}, f"{model} seed {seed}")
    return np.array(fitting.squares)


class Watched(fit.Fit):
    """A training run that remembers how it did on each validation drive: `squares`, as `errors` returns them."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.squares: list[list[tuple[float, float]]] = []

    def _validate(self, drives: Sequence[windows.Drive], target: predict.Target) -> tuple[float, float]:
        predicted = predict.over_drives(self.average.module, self.forward, drives, self.window, target)
        self.squares.append([])
        for drive, angle in zip(drives, predicted, strict=True):
            rows = drive.valid & ~np.isnan(angle)
            wanted = drive.steering_rad[rows]
            self.squares[-1].append((float(((angle[rows] - wanted) ** 2).sum()), float((wanted**2).sum())))
        return math.nan, nmse(np.array(self.squares[-1]))


def nmse(squares: np.ndarray) -> float:
    """Return the nmse over drives of which squares [D,2] are known."""
    error, zero = squares.sum(axis=0)
    return float(error / zero) if zero else math.nan


def judged(squares: np.ndarray) -> dict[str, tuple[float, float]]:
    """Return rule → nmse of the judging halves and number of the kept epoch, means over all halves that may choose."""
    drives = range(squares.shape[1])
    found: dict[str, list[tuple[float, int]]] = {rule: [] for rule in (*RULES, BY_CHANCE)}
    for choosing in combinations(drives, len(drives) // 2):
        judging = [drive for drive in drives if drive not in choosing]
        error = [nmse(epoch[judging]) for epoch in squares]
        curve = [
            Epoch(number, 0.0, 0.0, math.nan, nmse(epoch[list(choosing)]))
            for number, epoch in enumerate(squares, start=1)
        ]
        kept = {rule: kept_epoch(curve, rule) for rule in RULES} | {BY_CHANCE: 1 + int(np.argmin(error))}
        for rule, epoch in kept.items():
            found[rule].append((error[epoch - 1], epoch))
    return {rule: tuple(np.mean(rows, axis=0).tolist()) for rule, rows in found.items()}


def table(seeds: Sequence[dict[str, tuple[float, float]]], epochs: int) -> str:
    """Return the rules of several seeds side by side, as Markdown."""
    body = []
    for rule in seeds[0]:
        error = np.array([seed[rule][0] for seed in seeds])
        less = error - [seed["best"][0] for seed in seeds]
        body.append([
            rule, f"{error.mean():.4f}", f"{error.std(ddof=1):.4f}", f"{error.min():.4f} to {error.max():.4f}",
            f"{less.mean():+.4f} ± {less.std(ddof=1) / len(seeds) ** 0.5:.4f}",
            f"{np.mean([seed[rule][1] for seed in seeds]):.1f} of {epochs}",
        ])  # fmt: skip
    head = ["keep", "nmse", "between seeds", "range", "more than best, ± standard error", "kept epoch"]
    return "\n".join(markdown.table(head, body))


def _start() -> None:
    import torch

    torch.set_num_threads(1)
    sys.stdout = sys.stderr


if __name__ == "__main__":
    console.run(main)
