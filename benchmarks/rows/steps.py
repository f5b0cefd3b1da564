"""Rows of a whole training step: read, augment, forward, backward, clip, update, average."""

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from torch import nn

from benchmarks import training_step
from benchmarks.rows import files, recurrent
from benchmarks.rows.at_hand import FRAMES, Street
from benchmarks.rows.graph_network import pyg_like
from benchmarks.rows.row import Row, compare, ms
from models.steering.core import steering_net
from models.steering.core.features import node_features
from models.steering.spatial.gnn import GCN
from pipeline.base.params import load
from pipeline.sections.models import Model
from pipeline.sections.train import Train
from pipeline.train import frames, windows

WINDOW, WINDOWS = 8, 24  # FRAMES frames hold so many windows
PLAIN = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": WINDOW, "semantics": 1.0}


def equivariant_vs_plain(street: Street, device: str) -> Row:
    """What a network pays for being odd under mirroring."""
    return compare(
        _step(street, device, equivariant=True),
        _step(street, device, equivariant=False),
        "ms a frame",
        f"{street.points:,} points: a training step with equivariant / without",
    )


def windows_vs_naive(street: Street, device: str) -> Row:
    """The peer: GCNConv on edge_index and ncps's LTC, each window's frames loaded and encoded for it alone."""
    ours = _step(street, device, equivariant=False)
    with tempfile.TemporaryDirectory() as folder:
        naive = ms(_naive(files.save(street, Path(folder), WINDOW), device))
        return compare(
            lambda: 1e3 * WINDOWS / (ours() * FRAMES),
            lambda: 1e3 / naive(),
            "windows/s",
            f"{street.points:,} points: windows of {WINDOW} that share frames / PyG + ncps on naive ones, trained",
            more_is_better=True,
        )


def step_ms(street: Street, device: str) -> Row:
    """An equivariant step in a process of its own, after others."""
    step_s, _ = training_step.apart(whole_step, street, device, 5)
    return Row(1e3 * step_s / FRAMES, None, "ms a frame", None, _whole(street))


def peak_memory_gb(street: Street, device: str) -> Row:
    """The whole process of such a step."""
    _, peak_bytes = training_step.apart(whole_step, street, device, 3)
    return Row(peak_bytes / 1e9, None, "GB", None, f"{_whole(street)}, whole process")


def whole_step(street: Street, device: str, steps: int) -> tuple[float, int]:
    """Return the median seconds of equivariant steps, and the most memory that this process has had."""
    times = _times(street, device, True, steps)
    return statistics.median(times), training_step.peak_bytes()


def _whole(street: Street) -> str:
    return f"{street.points:,} points: an equivariant training step of {FRAMES} frames, reading included"


def _step(street: Street, device: str, equivariant: bool) -> Callable[[], float]:
    return lambda: 1e3 * statistics.median(_times(street, device, equivariant, 1)) / FRAMES


def _times(street: Street, device: str, equivariant: bool, steps: int) -> list[float]:
    """Return the seconds of `steps` training steps, after one that is not timed."""
    settings = load(Train, street.params)
    model = Model.model_validate({**PLAIN, "equivariant": equivariant})
    variant, labels = street.folder / "graphs/semantic", street.folder / "labels"
    (drive,) = windows.read_drives(variant, labels, [street.drive], WINDOW)
    drive = replace(drive, runs=((0, FRAMES),))
    torch.manual_seed(0)
    net = steering_net.build(model.model_dump(), **frames.contents(drive.graphs)).to(device)
    run = training_step.Training(net, drive, model, settings)
    return [after - before for before, after in pairwise(run.steps(steps + 2, time.perf_counter))][1:]


def _naive(paths: list[Path], device: str) -> Callable[[], None]:
    """Return a training step on one window of PyTorch Geometric's Data at `paths`."""
    from torch_geometric.data import Batch

    naive = Naive().to(device)
    optimiser = torch.optim.AdamW(naive.parameters())

    def step() -> None:
        batch = Batch.from_data_list([torch.load(path, weights_only=False) for path in paths]).to(device)
        optimiser.zero_grad()
        naive(batch).square().sum().backward()
        optimiser.step()

    return step


class Naive(nn.Module):
    """The same sizes of network, by PyTorch Geometric and ncps."""

    def __init__(self) -> None:
        super().__init__()
        ours = GCN(32)
        self.layers, self.read_out = pyg_like(ours), ours.read_out
        for layer in self.layers:
            layer.normalize = True  # type: ignore[assignment]  # as it does unless told otherwise
        self.temporal = recurrent.theirs(32)

    def forward(self, batch: Any) -> torch.Tensor:
        """Return what it says at the end of the batch's frames, one window [1]."""
        from torch_geometric.nn import global_max_pool, global_mean_pool

        x = node_features(batch.pos, batch.cls.to(torch.uint8), 1.0)
        for layer in self.layers:
            x = layer(x, batch.edge_index).relu()
        pooled = torch.cat([global_mean_pool(x, batch.batch), global_max_pool(x, batch.batch)], dim=1)
        heard = torch.tanh(self.read_out(pooled))
        window = torch.arange(len(heard), device=heard.device)[None]
        said: torch.Tensor = self.temporal(heard, window, torch.full(window.shape, 0.1, device=heard.device))
        return said
