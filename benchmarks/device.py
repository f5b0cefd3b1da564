"""Measure stages train and perception on this machine's device: on a GPU, whether it waits."""

import copy
import os
import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import torch
from torch.profiler import ProfilerActivity, profile

from benchmarks.networks import MODEL
from benchmarks.timing import DEVICE, FRAMES, make_street, milliseconds
from models.encoder.unified_encoder import build
from pipeline.base import store
from pipeline.base.params import load
from pipeline.base.resume import ROOT
from pipeline.camera.camera import Camera
from pipeline.labels import label, source
from pipeline.labels.settings import Labels
from pipeline.perception.perceive import GPU_BATCH, perceive
from pipeline.train import frames, windows
from pipeline.train.entry import Entry
from pipeline.train.fit import Fit
from pipeline.train.settings import Train
from pipeline.train.targets import LabelledDrive, read_drive

DRIVES = 8
ENTRY = Entry.model_validate(MODEL)
ENCODERS = {"small": (96, 320), "street": (192, 640)}  # (H, W) of images
Figures = Iterator[tuple[str, float]]


class Timed(Fit):
    """A training that notes when its first step has ended."""

    def _update_average(self, first: bool) -> None:
        super()._update_average(first)
        if first:
            next(self.average.parameters())[0].cpu()  # waits for the GPU
            self.first_s = time.perf_counter()


def training(folder: Path, points: int) -> Figures:
    """Yield what a training of the demo's sa-gnn-ncp on a street of random points takes, by stage
    train's own code.
    """
    drives = _drives(folder, points)
    paths, settings = [drive.graphs for drive in drives], load(Train, ROOT / "params.yaml")
    net = ENTRY.build("graph").to(DEVICE)
    fit = Timed(
        net,
        ENTRY,
        settings.model_copy(update={"epochs": 1}),
        0,
        drives[1:],
        drives[:1],
        frames.Files(paths),
    )
    start = time.perf_counter()
    with redirect_stdout(sys.stderr):  # outside of the table
        fit.run(folder / "state.pt", f"{points} points")
    yield "start of a training to its first step, s", fit.first_s - start
    kept, start = frames.Files(paths, "GPU" if DEVICE == "cuda" else "RAM"), time.perf_counter()
    kept.load(net.device)
    yield "loaded into memory, frames/s", DRIVES * FRAMES / (time.perf_counter() - start)
    del kept
    reader, steps = windows.Reader(drives[1:], ENTRY.window, fit.files), len(fit._plan(2))
    yield "step, ms", milliseconds(lambda: fit._train(reader, 2), steps)()
    if DEVICE == "cuda":
        torch.cuda.reset_peak_memory_stats()
        with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiled:
            wall_s = -time.perf_counter()
            fit._train(reader, 3)
            wall_s += time.perf_counter()
        events = profiled.key_averages()
        kernels = [
            event
            for event in events
            if event.device_type.name == "CUDA" and not event.is_user_annotation
        ]
        yield (
            "kernel time / wall time",
            sum(event.self_device_time_total for event in kernels) / wall_s / 1e6,
        )
        yield (
            "launches per step",
            sum(event.count for event in events if "Launch" in event.key) / steps,
        )
        # the end of an epoch and the profiler wait, too
        for text in ("Synchronize", "Pageable ->"):
            yield (
                f"events with {text} in an epoch of {steps} steps",
                sum(e.count for e in events if text in e.key),
            )
        yield "peak memory, GiB", torch.cuda.max_memory_allocated() / 2**30
    batch, alone = reader[[windows.Span(0, 0, FRAMES)]], copy.deepcopy(net).cpu().eval()
    with torch.no_grad():
        difference = net.eval()(*net.inputs(batch)).cpu() - alone(*alone.inputs(batch))
    yield "outputs, largest difference to the CPU's", difference.abs().max().item()


def perception() -> Figures:
    """Yield the time per image of encoders with random weights."""
    for backbone, size in ENCODERS.items():
        network = build({"backbone": backbone}).to(DEVICE, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
        images = np.zeros((GPU_BATCH if DEVICE == "cuda" else 1, *size, 3), np.uint8)
        camera = Camera(
            np.array([[size[1], 0, size[1] / 2], [0, size[1], size[0] / 2], [0, 0, 1]]), size
        )
        measure = milliseconds(lambda: perceive(network, images, camera, "auto"), len(images))  # noqa: B023
        yield f"perception, {backbone}, ms/image", min(measure() for _ in range(3))


def _drives(folder: Path, points: int) -> list[LabelledDrive]:
    """Write DRIVES times the same street, with a label for each frame."""
    street, frame = make_street(folder, points), np.arange(FRAMES)
    angle_rad, speed_mps = 0.1 * np.sin(frame / 5), np.full(FRAMES, 8.0)
    labels = label.Labels(
        angle_rad, np.ones(FRAMES, bool), speed_mps, speed_mps * np.tan(angle_rad) / 2.7
    )
    settings = Labels(wheelbase_m=2.7, min_speed_mps=1.0)
    for name in (names := [f"street-{number}" for number in range(DRIVES)]):
        os.link(street.file, folder / f"{name}.h5")
        params = {"labels": settings.model_dump()}
        with store.DriveWriter(
            folder / f"labels/{name}.h5", stage="labels", drive=name, params=params
        ) as file:
            source.write_labels(file, frame, frame * 0.1, labels, settings)
    return [read_drive(folder, folder / "labels", name, ENTRY) for name in names]
