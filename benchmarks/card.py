"""Measure the speed of stage train on this machine, and how long a GPU waits."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch.profiler import profile

from pipeline.jobs import console

from benchmarks.alternatives import DEVICE, ENTRY, FRAMES, Work, milliseconds, now_s, write_street
from pipeline.base.checkout import ROOT
from pipeline.base.params import load_section
from pipeline.labels import label, source
from pipeline.labels.label_file import create_labels
from pipeline.labels.settings import Labels
from pipeline.train.fit import Fit
from pipeline.train.frames import Files
from pipeline.train.settings import Train
from pipeline.train.targets import LabelledDrive, read_drive
from pipeline.train.windows import Reader

PARAMS = ROOT / "params.yaml"

# Number of drives of the training. All of them have the frames of the same street.
DRIVES = 7


def main() -> None:
    """Print how long a training takes to its first step, and a step."""
    torch.set_num_threads(1)
    with TemporaryDirectory() as folder:
        measure_training(Path(folder))


def measure_training(folder: Path) -> None:
    """Train sa-gnn-ncp of the demo on a street of random points, by the code of stage train."""
    drive = labelled_street(folder)
    drives = [drive] * DRIVES
    settings = load_section(Train, PARAMS).model_copy(update={"epochs": 1})
    net = ENTRY.build("graph").to(DEVICE)
    fit = Fit(net, ENTRY, settings, 0, train=drives, val=[], files=Files([drive.graphs]))

    # The first epoch runs as in stage train, with its preparations.
    step_ends_s: list[float] = []
    hook = fit.optimiser.register_step_post_hook(lambda *_: step_ends_s.append(now_s()))
    start_s = now_s()
    fit.train_network(folder / "state.pt", "benchmark")
    hook.remove()
    print_value("start of a training to its first step, s", step_ends_s[0] - start_s)

    # A later epoch needs no preparations.
    reader = Reader(drives, ENTRY.window, fit.files)

    def train_epoch() -> int:
        fit._train_epoch(reader, 2)
        return len(fit._plan_epoch(2))

    print_value("step, ms", milliseconds(train_epoch))
    if DEVICE == "cuda":
        profile_training(train_epoch)


def labelled_street(folder: Path) -> LabelledDrive:
    """Write a street of random points, and labels of its frames."""
    street = write_street(folder)
    settings = load_section(Labels, PARAMS)
    numbers = np.arange(FRAMES)
    car = label.Car(settings.wheelbase_m, settings.min_speed_mps)
    labels = label.steering_labels(0.3 * np.sin(numbers / 5), np.full(FRAMES, 8.0), car)
    params = {"labels": settings.model_dump()}
    path = folder / "labels" / street.name
    with create_labels(path, drive=street.stem, params=params) as file:
        source.write_labels(file, numbers, numbers * 0.1, labels, settings)
    motion = folder / "motion"  # not read, as the network has motion: none
    return read_drive(folder, path.parent, motion, street.stem, ENTRY)


def profile_training(train_epoch: Work) -> None:
    """Print which share of an epoch a GPU computes, and how often it is launched and waited for."""
    torch.cuda.reset_peak_memory_stats()
    with profile() as profiled:
        start_s = now_s()
        steps = train_epoch()
        wall_s = now_s() - start_s

    kernel_us = 0.0
    launches = 0
    waits = 0
    for event in profiled.key_averages():
        if event.device_type.name == "CUDA" and not event.is_user_annotation:
            kernel_us += event.self_device_time_total
        if "Launch" in event.key:
            launches += event.count
        if "Synchronize" in event.key:
            waits += event.count
    print_value("kernel time / wall time", kernel_us / 1e6 / wall_s)
    print_value("launches per step", launches / steps)
    # This value includes waits at the end of the epoch, of this measurement and of the profiler.
    print_value("synchronisations per step", waits / steps)
    print_value("peak memory, GiB", torch.cuda.max_memory_allocated() / 2**30)


def print_value(what: str, value: float) -> None:
    """Print a value with three digits. `what` names the value and its unit."""
    print(f"{what}: {value:.3g}", flush=True)


if __name__ == "__main__":
    console.run(main)
