"""Measure the networks beside PyTorch Geometric and ncps: graph convolutions, the LTC cell, and a training step."""

import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from benchmarks.graphs import edge_index, save
from benchmarks.street import DEVICE, FRAMES, Row, Street, compare, milliseconds
from models.steering.core.batch import GraphBatch
from models.steering.core.cell.ltc import LTC
from models.steering.core.features import mean_max_pool, node_features
from models.steering.core.wiring import ncp
from models.steering.spatial.gnn import GCN, GCNLayer
from pipeline.settings.models import Entry

GCN_FRAMES = 4  # per batch
WINDOW, FEATURES = 8, 32
WINDOWS = FRAMES - WINDOW + 1
REPEATS = 10  # of the LTC cell
MODEL = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": WINDOW, "features": FEATURES}
MODEL |= {"semantics": 1.0}


def beside_edge_index(street: Street) -> Row:
    """Compare with GCNConv on edge_index; the normalisation is computed once per batch, for all layers."""
    batch = street.batch(GCN_FRAMES)
    return _compare_gcn(street, batch, "edge_index", lambda: normalised(batch))


def beside_csr(street: Street) -> Row:
    """Compare with GCNConv on torch's sparse CSR matrix, which is made once and is not timed."""
    batch = street.batch(GCN_FRAMES)
    index, weight = normalised(batch)
    shape = (len(batch.xyz), len(batch.xyz))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse (CSR tensor support is in beta|invariant checks)")
        matrix = torch.sparse_coo_tensor(index.flip(0), weight, shape).coalesce().to_sparse_csr()
    return _compare_gcn(street, batch, "CSR", lambda: (matrix,))


def _compare_gcn(street: Street, batch: GraphBatch, form: str, graph: Callable[[], tuple[Tensor, ...]]) -> Row:
    net = GCN(1).to(DEVICE)
    layers = pyg_layers(net)
    return compare(
        milliseconds(lambda: _backward(net.pooled(batch, 1)), GCN_FRAMES),
        milliseconds(lambda: _backward(pooled(layers, graph(), batch)), GCN_FRAMES),
        "ms/frame",
        f"{street.title}: three graph convolutions / PyG GCNConv on {form}, forward + backward",
    )


def normalised(batch: GraphBatch) -> tuple[Tensor, Tensor]:
    """Return edges [2,E+N] with self-loops and their weights [E+N] by Kipf's normalisation."""
    from torch_geometric.nn.conv.gcn_conv import gcn_norm

    index, weight = gcn_norm(edge_index(batch), None, len(batch.xyz))
    return index, weight


def pyg_layers(net: GCN, normalize: bool = False) -> nn.ModuleList:
    """Return PyTorch Geometric's layers with the weights of ours."""
    from torch_geometric.nn import GCNConv

    layers = nn.ModuleList()
    for ours in cast(list[GCNLayer], net.layers):
        layer = GCNConv(*ours.weight.shape, normalize=normalize)
        layer.lin.weight.data = ours.weight.data.T.clone()
        layer.bias.data = ours.bias.data.clone()
        layers.append(layer)
    return layers.to(net.read_out.weight.device)


def pooled(layers: nn.ModuleList, graph: tuple[Tensor, ...], batch: GraphBatch) -> Tensor:
    """Return the pooled node features [B, 2 width] after the layers."""
    x = node_features(batch.xyz, batch.cls, 0.0)
    for layer in layers:
        x = layer(x, *graph).relu()
    return mean_max_pool(x, batch.ptr)


def ltc() -> Row:
    """Compare LTC cells on windows that share frames, forward and backward."""
    torch.manual_seed(0)
    x, (windows, dt_s) = torch.randn(FRAMES, FEATURES, device=DEVICE), _windows()
    ours, alternative = LTC(ncp(FEATURES)).to(DEVICE), ncps_ltc().to(DEVICE)

    def repeat(net: nn.Module, forward: Callable[[], Tensor]) -> Callable[[], float]:
        def work() -> None:
            for _ in range(REPEATS):
                net.zero_grad()
                _backward(forward()[:, -1, 0])

        return milliseconds(work, REPEATS)

    return compare(
        repeat(ours, lambda: ours(ours.project_inputs(x)[windows], dt_s)[0]),
        repeat(alternative, lambda: alternative(x[windows])[0]),
        "ms",
        f"{WINDOWS} windows of {WINDOW} frames, {FEATURES} features: LTC / ncps LTC, forward + backward",
    )


def ncps_ltc() -> nn.Module:
    """Return the LTC network of ncps on a wiring of the same sizes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from ncps import torch as ncps_torch
        from ncps.wirings import NCP

    neurons = {"inter_neurons": 12, "command_neurons": 6, "motor_neurons": 1}
    synapses = {"sensory_fanout": 6, "inter_fanout": 4, "recurrent_command_synapses": 6, "motor_fanin": 6}
    net: nn.Module = ncps_torch.LTC(FEATURES, NCP(**neurons, **synapses), batch_first=True)
    return net


def training(street: Street) -> Row:
    """Compare training on windows that share frames with PyG and ncps on one window after the other.

    A step reads a run of frames, and does forward, backward and update.
    """
    with tempfile.TemporaryDirectory() as folder:
        ours = milliseconds(_shared_step(street), WINDOWS)
        alternative = milliseconds(_naive_step(save(street, Path(folder), WINDOW)))
        return compare(
            lambda: 1e3 / ours(),
            lambda: 1e3 / alternative(),
            "windows/s",
            f"{street.title}: training with shared frames / PyG + ncps, each window read and encoded for itself",
        )


def _shared_step(street: Street) -> Callable[[], None]:
    """Return a training step on all windows of a run of FRAMES frames, each encoded once."""
    torch.manual_seed(0)
    net = Entry.model_validate(MODEL).build("graph").to(DEVICE)
    return _step(net, lambda: net(street.batch(FRAMES), *_windows()))


def _naive_step(paths: list[Path]) -> Callable[[], None]:
    """Return a training step on the one window of PyTorch Geometric's Data at `paths`."""
    from torch_geometric.data import Batch

    net = NaiveNet().to(DEVICE)

    def forward() -> Tensor:
        output: Tensor = net(Batch.from_data_list([torch.load(path, weights_only=False) for path in paths]).to(DEVICE))
        return output

    return _step(net, forward)


def _step(net: nn.Module, forward: Callable[[], Tensor]) -> Callable[[], None]:
    optimiser = torch.optim.AdamW(net.parameters())

    def work() -> None:
        optimiser.zero_grad()
        _backward(forward())
        optimiser.step()

    return work


class NaiveNet(nn.Module):
    """A network of the same sizes, by PyTorch Geometric and ncps."""

    def __init__(self) -> None:
        super().__init__()
        ours = GCN(FEATURES)
        self.layers, self.read_out = pyg_layers(ours, normalize=True), ours.read_out
        self.temporal = ncps_ltc()

    def forward(self, batch: Any) -> Tensor:
        """Return the output at the end of the batch's frames, which are one window: [1]."""
        from torch_geometric.nn import global_max_pool, global_mean_pool

        x = node_features(batch.pos, batch.cls.to(torch.uint8), 1.0)
        for layer in self.layers:
            x = layer(x, batch.edge_index).relu()
        x = torch.cat([global_mean_pool(x, batch.batch), global_max_pool(x, batch.batch)], dim=1)
        output: Tensor = self.temporal(torch.tanh(self.read_out(x))[None])[0][:, -1, 0]
        return output


def _windows() -> tuple[Tensor, Tensor]:
    """Return the rows of the frames of all windows, int64 [W,T], and their time steps in s."""
    rows = torch.arange(WINDOWS, device=DEVICE)[:, None] + torch.arange(WINDOW, device=DEVICE)
    return rows, torch.full(rows.shape, 0.1, device=DEVICE)


def _backward(output: Tensor) -> None:
    output.square().sum().backward()  # type: ignore[no-untyped-call]
