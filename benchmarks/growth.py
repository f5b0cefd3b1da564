"""How a training step's time and memory grow with points, frames and window: the curves of docs/scale.md.

python -m benchmarks.growth ../shared/kitti
"""

import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import torch

from benchmarks import training_step
from benchmarks.rows import at_hand, files
from benchmarks.rows.at_hand import FRAMES, Street
from models.steering.core import steering_net
from pipeline.base import console
from pipeline.base.params import load
from pipeline.report.tables import markdown
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import frames, windows

POINTS = (1_000, 10_000, 20_000, 43_000, 86_000)
RUNS = (1, 2, 4)  # of FRAMES frames each, in a step
WINDOWS = (1, 4, 8, 16)
AT = 43_000  # points, where something else grows
STEPS = 3


@dataclass(frozen=True)
class Setting:
    """A training step of sa-gnn-ncp: its frames come in `runs` runs of FRAMES."""

    points: int = AT
    runs: int = 1
    window: int = 8
    equivariant: bool = False


def main(kitti: Path, steps: int = STEPS) -> None:
    """Measure on the scans of a KITTI raw folder, and print Markdown tables; each step in a process of its own."""
    with tempfile.TemporaryDirectory() as scratch:
        streets = {}
        for points in POINTS:
            folder = Path(scratch) / str(points)
            folder.mkdir()
            with contextlib.redirect_stdout(sys.stderr):
                streets[points] = at_hand.recorded(kitti, folder, points)
        by_points = [Setting(points, equivariant=equivariant) for points in POINTS for equivariant in (False, True)]
        print(_table("points", by_points, streets, steps))
        print(_table("frames", [Setting(runs=runs) for runs in RUNS], streets, steps))
        print(_table("window", [Setting(window=window) for window in WINDOWS], streets, steps))
        reading = [[f"{points:,}", f"{files.load(streets[points], 'cpu').ours:.2f}"] for points in POINTS]
        print("\n".join(markdown.table(["points", "ms to read a frame"], reading)))
    print(f"\n{torch.get_num_threads()} threads")


def _table(what: str, settings: Iterable[Setting], streets: dict[int, Street], steps: int) -> str:
    body = []
    for setting in settings:
        step_s, peak_bytes = training_step.apart(step, streets[setting.points], setting, steps)
        count = FRAMES * setting.runs
        body.append([
            f"{setting.points:,}", str(count), str(setting.window), "yes" if setting.equivariant else "no",
            f"{1e3 * step_s / count:.1f}", f"{peak_bytes / 1e9:.2f}",
            f"{streets[setting.points].file.stat().st_size / FRAMES / 1e6:.3f}",
        ])  # fmt: skip
    head = ["points", "frames a step", "window", "equivariant", "ms a frame", "peak GB", "MB a frame on disk"]
    return f"By {what}:\n\n" + "\n".join(markdown.table(head, body)) + "\n"


def step(street: Street, setting: Setting, steps: int) -> tuple[float, int]:
    """Return the median seconds of training steps, reading included, and the most memory that this process has had."""
    content = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": setting.window, "semantics": 1.0}
    model = Model.model_validate({**content, "equivariant": setting.equivariant})
    settings = load(Train, street.params).model_copy(update={"batch_runs": setting.runs})
    variant, labels = street.folder / "graphs/semantic", street.folder / "labels"
    (drive,) = windows.read_drives(variant, labels, [street.drive], setting.window)
    drive = replace(drive, runs=((0, FRAMES),))
    torch.manual_seed(0)
    net = steering_net.build(model.model_dump(), **frames.contents(drive.graphs))
    run = training_step.Training(net, drive, model, settings)
    times = [after - before for before, after in pairwise(run.steps(steps + 2, time.perf_counter))][1:]
    return statistics.median(times), training_step.peak_bytes()


if __name__ == "__main__":
    console.run(main)
