"""Measure a training step of sa-gnn-ncp: read a run of frames, forward, backward, update."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from benchmarks import files
from benchmarks.graph_network import pyg_layers
from benchmarks.recurrent import ncps_ltc
from benchmarks.row import DEVICE, Row, compare, milliseconds
from benchmarks.street import FRAMES, Street
from models.steering.core import steering_net
from models.steering.core.features import node_features
from models.steering.spatial.gnn import GCN

WINDOW = 8
WINDOWS = FRAMES - WINDOW + 1
MODEL = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": WINDOW, "features": 32}
MODEL |= {"equivariant": False, "motion": "none", "semantics": 1.0}


def windows(street: Street) -> Row:
    """Compare training on windows that share frames with PyG and ncps on one window after the other."""
    with tempfile.TemporaryDirectory() as folder:
        ours, alternative = shared_step(street), naive_step(files.save(street, Path(folder), WINDOW))
        milliseconds_ours, milliseconds_alternative = milliseconds(ours, WINDOWS), milliseconds(alternative)
        return compare(
            lambda: 1e3 / milliseconds_ours(),
            lambda: 1e3 / milliseconds_alternative(),
            "windows/s",
            f"{street.title}: training with shared frames / PyG + ncps, each window read and encoded for itself",
            higher_is_better=True,
        )


def shared_step(street: Street) -> Callable[[], None]:
    """Return a training step on all windows of a run of FRAMES frames, each encoded once."""
    torch.manual_seed(0)
    net = steering_net.build(MODEL).to(DEVICE)
    optimiser = torch.optim.AdamW(net.parameters())
    rows = torch.arange(WINDOWS, device=DEVICE)[:, None] + torch.arange(WINDOW, device=DEVICE)
    dt_s = torch.full(rows.shape, 0.1, device=DEVICE)

    def work() -> None:
        optimiser.zero_grad()
        net(street.batch(FRAMES), rows, dt_s).square().sum().backward()
        optimiser.step()

    return work


def naive_step(paths: list[Path]) -> Callable[[], None]:
    """Return a training step on the one window of PyTorch Geometric's Data at `paths`."""
    from torch_geometric.data import Batch

    net = NaiveNet().to(DEVICE)
    optimiser = torch.optim.AdamW(net.parameters())

    def work() -> None:
        batch = Batch.from_data_list([torch.load(path, weights_only=False) for path in paths]).to(DEVICE)
        optimiser.zero_grad()
        net(batch).square().sum().backward()
        optimiser.step()

    return work


class NaiveNet(nn.Module):
    """A network of the same sizes, by PyTorch Geometric and ncps."""

    def __init__(self) -> None:
        super().__init__()
        ours = GCN(32)
        self.layers, self.read_out = pyg_layers(ours, normalize=True), ours.read_out
        self.temporal = ncps_ltc(32)

    def forward(self, batch: Any) -> Tensor:
        """Return the output at the end of the batch's frames, which are one window: [1]."""
        from torch_geometric.nn import global_max_pool, global_mean_pool

        x = node_features(batch.pos, batch.cls.to(torch.uint8), 1.0)
        for layer in self.layers:
            x = layer(x, batch.edge_index).relu()
        x = torch.cat([global_mean_pool(x, batch.batch), global_max_pool(x, batch.batch)], dim=1)
        output: Tensor = self.temporal(torch.tanh(self.read_out(x))[None])[0][:, -1, 0]
        return output
