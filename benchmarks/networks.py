"""Measure networks beside PyTorch Geometric and ncps: convolutions, LTC, a training step with its
reading.
"""

from collections.abc import Callable
from typing import Any, cast

import torch
from ncps import torch as ncps_torch
from ncps.wirings import NCP
from torch import Tensor, nn
from torch_geometric.data import Batch
from torch_geometric.nn import GCNConv
from torch_geometric.nn.conv.gcn_conv import gcn_norm

from benchmarks.timing import DEVICE, FRAMES, Row, Street, milliseconds
from models.steering.core.cell.ltc import LTC
from models.steering.core.features import mean_max_pool, node_features
from models.steering.core.wiring import ncp
from models.steering.spatial.gnn import GCN, GCNLayer, Options
from pipeline.train.entry import Entry

GCN_FRAMES = 4  # per batch
WINDOW, FEATURES = 8, 32
WINDOWS = FRAMES - WINDOW + 1
REPEATS = 10  # of the LTC cell
MODEL = {
    "input": "semantic",
    "spatial": "gnn",
    "temporal": "ncp",
    "window": WINDOW,
    "semantics": 1.0,
}


def gcn(street: Street) -> Row:
    """Compare graph convolutions with GCNConv on edge_index, normalised once per batch for all
    layers.
    """
    batch, net = street.batch(GCN_FRAMES), GCN(1, Options(semantics=0.0)).to(DEVICE)
    layers = pyg_layers(net)

    def alternative() -> None:
        x = node_features(batch.xyz, batch.cls, 0.0)
        _backward(
            features(x, layers, gcn_norm(batch.edge_index, None, len(x)), batch.ptr, net.read_out)
        )

    ours = milliseconds(lambda: _backward(net(batch)), GCN_FRAMES)
    what = f"{street.title}: three graph convolutions / PyG GCNConv on edge_index, both ways"
    return Row(ours, milliseconds(alternative, GCN_FRAMES), "ms/frame", what)


def pyg_layers(net: GCN, normalize: bool = False) -> nn.ModuleList:
    """Return PyTorch Geometric's layers with the weights of ours."""
    layers = nn.ModuleList()
    for ours in cast(list[GCNLayer], net.layers):
        layer = GCNConv(*ours.weight.shape, normalize=normalize)
        layer.lin.weight.data, layer.bias.data = ours.weight.data.T.clone(), ours.bias.data.clone()
        layers.append(layer)
    return layers.to(net.read_out.weight.device)


def features(
    x: Tensor, layers: nn.ModuleList, graph: tuple[Tensor, ...], ptr: Tensor, read_out: nn.Module
) -> Tensor:
    """Return the features [B,F] that GCN computes from node features x, by PyTorch Geometric's
    `layers`.
    """
    for layer in layers:
        x = layer(x, *graph).relu()
    return read_out(mean_max_pool(x, ptr))


def ltc(_: Street) -> Row:
    """Compare LTC cells on windows that share frames, forward and backward."""
    x, (windows, dt_s) = torch.randn(FRAMES, FEATURES, device=DEVICE), _windows()
    cell, ncps_cell = LTC(ncp(FEATURES)).to(DEVICE), ncps_ltc().to(DEVICE)

    def repeat(forward: Callable[[], Tensor]) -> None:
        for _ in range(REPEATS):
            _backward(forward()[:, -1, 0])

    ours = milliseconds(
        lambda: repeat(lambda: cell(cell.project_inputs(x)[windows], dt_s)), REPEATS
    )
    alternative = milliseconds(lambda: repeat(lambda: ncps_cell(x[windows])[0]), REPEATS)
    what = f"{WINDOWS} windows of {WINDOW} frames, {FEATURES} features: LTC / ncps LTC, both ways"
    return Row(ours, alternative, "ms", what)


def ncps_ltc() -> nn.Module:
    """Return the LTC network of ncps on a wiring of the same sizes."""
    neurons = {"inter_neurons": 12, "command_neurons": 6, "motor_neurons": 1}
    synapses = {
        "sensory_fanout": 6,
        "inter_fanout": 4,
        "recurrent_command_synapses": 6,
        "motor_fanin": 6,
    }
    return ncps_torch.LTC(FEATURES, NCP(**neurons, **synapses), batch_first=True)


def training(street: Street) -> Row:
    """Compare training steps, reading included, on windows that share frames with PyG and ncps on
    one at a time.
    """
    shared, naive = Entry.model_validate(MODEL).build("graph").to(DEVICE), NaiveNet().to(DEVICE)
    paths = street.frames[:WINDOW]

    def read_window() -> Any:
        return Batch.from_data_list([torch.load(path, weights_only=False) for path in paths]).to(
            DEVICE
        )

    ours = milliseconds(_step(shared, lambda: shared(street.batch(FRAMES), *_windows())), WINDOWS)
    alternative = milliseconds(_step(naive, lambda: naive(read_window())))
    what = (
        f"{street.title}: training with shared frames / PyG + ncps, each window read and encoded "
        "for itself"
    )
    return Row(lambda: 1e3 / ours(), lambda: 1e3 / alternative(), "windows/s", what)


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
        ours = GCN(FEATURES, Options(semantics=1.0))
        self.layers, self.read_out = pyg_layers(ours, normalize=True), ours.read_out
        self.temporal = ncps_ltc()

    def forward(self, batch: Any) -> Tensor:
        """Return the output at the end of the batch's frames, which are one window: [1]."""
        x = node_features(batch.pos, batch.cls, 1.0)
        x = features(x, self.layers, (batch.edge_index,), batch.ptr.cpu(), self.read_out)
        return self.temporal(torch.tanh(x)[None])[0][:, -1, 0]


def _windows() -> tuple[Tensor, Tensor]:
    """Return the rows of the frames of all windows, int64 [W,T], and their time steps in s."""
    rows = torch.arange(WINDOWS, device=DEVICE)[:, None] + torch.arange(WINDOW, device=DEVICE)
    return rows, torch.full(rows.shape, 0.1, device=DEVICE)


def _backward(output: Tensor) -> None:
    output.square().sum().backward()  # type: ignore[no-untyped-call]
