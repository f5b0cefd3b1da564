"""What one training step of each model costs at the paper's sizes: seconds, memory, bytes. See docs/scale.md."""

import contextlib
import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import typer

from benchmarks import town_frames
from pipeline.base import console
from pipeline.base.errors import InputError, closest
from pipeline.base.params import load, load_entry, names
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import frames, windows

T = TypeVar("T")
READINGS = 3  # of a step's frames; the median counts


@dataclass(frozen=True)
class Row:
    """One model's figures. Times are medians; `step_s` includes augmenting frames and reading later ones."""

    model: str
    frame: str  # what one is
    frames: int  # per step
    windows: int  # per step
    parameters: int
    step_s: float
    read_s: float  # a step's frames, from files that the system has in memory
    peak_bytes: int  # resident memory of the process, all included
    bare_bytes: int  # the same before there was a network or a frame
    flop: float  # per frame, as benchmarks/work.py counts
    moved_bytes: float  # per frame, likewise
    operators: int  # per step
    disk_bytes: float  # per frame, in the graph file
    device: str


def main(
    models: Annotated[list[str] | None, typer.Argument(metavar="MODEL", help="default: all of preset table2")] = None,
    preset: Annotated[str, typer.Option(help="whose sizes: a name in presets/, or a file")] = "kitti",
    steps: Annotated[int, typer.Option(min=1, help="timed, after one that is not")] = 3,
) -> None:
    """Measure one training step of each model on generated frames, and print a Markdown table.

    Each model has a process of its own, so that its peak memory is its own. What stages and training print goes to
    stderr.
    """
    with tempfile.TemporaryDirectory() as scratch, contextlib.redirect_stdout(sys.stderr):
        folder = Path(scratch)
        written = folder / "params.yaml"
        town_frames.write_params(preset, written, frames=1)
        known = names("models", written)
        for name in models or []:
            if name not in known:
                raise InputError(f"there is no model {name!r}: {closest(name, known)}")
        entries = {name: load_entry(Model, "models", name, written) for name in models or known}
        longest = max(entry.window for entry in entries.values())
        count = max(step_frames(longest, load(Train, written)), town_frames.BENT)
        town_frames.write_params(preset, written, count)
        apart(town_frames.make, written, folder, sorted({entry.input for entry in entries.values()}))
        rows = [apart(measure, name, written, folder, steps) for name in entries]
    print(table(rows))


def step_frames(window: int, settings: Train) -> int:
    """Return how many consecutive frames hold the windows of one run."""
    return settings.run_windows + window - 1


def measure(name: str, params: Path, folder: Path, steps: int) -> Row:
    """Train model `name` of the params file for `steps` + 2 steps on the frames that town_frames made in `folder`."""
    import torch

    from benchmarks import work
    from models.steering.core import steering_net

    bare_bytes = peak_bytes()
    model, settings = load_entry(Model, "models", name, params), load(Train, params)
    count = step_frames(model.window, settings)
    (drive,) = windows.read_drives(
        folder / "graphs" / model.input, folder / "labels", [town_frames.DRIVE], model.window
    )
    drive = replace(drive, runs=((0, count),))
    group = [windows.Span(0, 0, count)] * settings.batch_runs
    reading = []
    for _ in range(READINGS):
        start = time.perf_counter()
        (batch,) = windows.batches([drive], [group], model.window)
        reading.append(time.perf_counter() - start)
    frame, total, predictions = describe(batch), len(group) * count, len(batch["windows"])
    del batch

    torch.manual_seed(0)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    net = steering_net.build(model.model_dump(), **frames.contents(drive.graphs)).to(device)
    training = Training(net, drive, model, settings)
    # From one forward pass to the next: backward pass, clipping, update, average, and what a thread reads meanwhile.
    times = [after - before for before, after in pairwise(training.steps(steps + 2, time.perf_counter))]
    most_bytes = peak_bytes()
    with work.Counter() as counter:
        before, after = training.steps(2, lambda: counter.work)
    flop, moved_bytes, operators = np.subtract(after, before)
    return Row(
        name,
        frame,
        frames=total,
        windows=predictions,
        parameters=steering_net.parameter_count(net),
        step_s=statistics.median(times[1:]),
        read_s=statistics.median(reading),
        peak_bytes=most_bytes,
        bare_bytes=bare_bytes,
        flop=flop / total,
        moved_bytes=moved_bytes / total,
        operators=int(operators),
        disk_bytes=drive.graphs.stat().st_size / len(drive.frame),
        device=f"{device.type}, {torch.get_num_threads()} threads",
    )


class Training:
    """Steps on the whole of one drive's runs, as stage train makes them."""

    def __init__(self, net: Any, drive: windows.Drive, model: Model, settings: Train) -> None:
        # An epoch cuts runs at random places. Ours are as long as a step's, and must stay whole.
        self.settings = settings.model_copy(update={"epochs": 1, "run_windows": 1 << 40})
        self.net, self.drive, self.model = net, drive, model

    def steps(self, steps: int, probe: Callable[[], T]) -> list[T]:
        """Train for `steps` steps; return what `probe` says as the forward pass of each begins."""
        from pipeline.train import fit

        readings = []

        self.net.register_forward_pre_hook(lambda *_: readings.append(probe()))
        run = fit.Fit(self.net, self.model.window, self.model.alpha, self.settings, seed=0)
        with tempfile.TemporaryDirectory() as kept:
            run.run([self.drive] * (steps * self.settings.batch_runs), [], Path(kept) / "state.pt", {}, "benchmark")
        return readings


def describe(batch: windows.Batch) -> str:
    """Say what a frame of the batch is, on average."""
    if "image" in batch:
        height, width = batch["image"].shape[1:3]
        return f"{height} × {width} pixels"
    count = len(batch["ptr"]) - 1
    text = f"{len(batch['xyz']) / count:,.0f} points"
    if "indices" in batch:
        return f"{text}, {len(batch['indices']) / count:,.0f} neighbours"
    sets = [array for name, array in sorted(batch.items()) if name.startswith("neighbours_")]
    return ", ".join([text, *(f"{len(array) / count:,.0f} × {array.shape[1]}" for array in sets)])


def table(rows: list[Row]) -> str:
    """Return the rows as Markdown: what was measured, then what was counted."""
    bare = statistics.median(row.bare_bytes for row in rows) / 1e6
    measured = [
        *("model", "a frame", "frames a step", "s a step", "ms a frame", "of it reading", "peak MB"),
        *("MB a frame on disk",),
    ]
    counted = ["model", "parameters", "windows a step", "GFLOP a frame", "MB moved a frame", "operators a step"]
    return "\n".join([
        *_lines(measured, [
            [
                *(row.model, row.frame, str(row.frames), f"{row.step_s:.2f}", f"{1e3 * row.step_s / row.frames:.0f}"),
                *(f"{1e3 * row.read_s / row.frames:.1f}", f"{row.peak_bytes / 1e6:,.0f}"),
                f"{row.disk_bytes / 1e6:.2f}",
            ]
            for row in rows
        ]),
        f"\n{rows[0].device}; a process with torch and nothing else: {bare:,.0f} MB\n",
        *_lines(counted, [
            [
                *(row.model, f"{row.parameters:,}", str(row.windows), f"{row.flop / 1e9:.2f}"),
                *(f"{row.moved_bytes / 1e6:.0f}", f"{row.operators:,}"),
            ]
            for row in rows
        ]),
    ])  # fmt: skip


def _lines(head: list[str], body: list[list[str]]) -> list[str]:
    rule = ["---" if cell in ("model", "a frame") else "--:" for cell in head]
    return [f"| {' | '.join(cells)} |" for cells in (head, rule, *body)]


def apart(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call it in a new process."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_to_stderr) as pool:
        return pool.submit(function, *arguments).result()


def _to_stderr() -> None:
    sys.stdout = sys.stderr


def peak_bytes() -> int:
    """Return the most memory that this process has had, all included.

    Not getrusage's: to a process that another starts, Linux counts what the other had then.
    """
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024  # in KiB


if __name__ == "__main__":
    console.run(main)
