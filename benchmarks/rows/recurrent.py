"""Rows of the recurrent networks: 24 windows of 8 of a run's 31 frames, 32 features each, forward + backward."""

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from benchmarks.rows.row import Row, compare, ms
from models.steering.core.knobs import Sizes
from models.steering.core.recurrent import NOMINAL_STEP_S, RecurrentCell
from models.steering.core.wiring import Layout
from models.steering.temporal import lstm, ncp

WINDOWS, WINDOW, FEATURES = 24, 8, 32


def vs_ncps(device: str) -> Row:
    """LTC beside that of ncps, on its own wiring of the same sizes."""
    return _compare(device, _ours(ncp.Knobs().build(Sizes(FEATURES))), theirs(FEATURES), "LTC / ncps LTC")


def vs_lstm(device: str) -> Row:
    """How close LTC's 48 steps of an ODE are to the 8 of an LSTM with 32 units."""
    return _compare(
        device, _ours(ncp.Knobs().build(Sizes(FEATURES))), _ours(lstm.LSTM(FEATURES)), "LTC / LSTM of 32 units, ours"
    )


def theirs(features: int) -> nn.Module:
    """Return ncps's LTC on a wiring of the sizes of ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from ncps.torch import LTC
        from ncps.wirings import NCP

    sizes = Layout()
    wiring = NCP(
        *(sizes.inter, sizes.command, 1, sizes.sensory_fanout, sizes.inter_fanout),
        *(sizes.recurrent_command_synapses, sizes.motor_fanin),
    )
    return Theirs(LTC(features, wiring, batch_first=True))


class Theirs(nn.Module):
    """ncps's network on windows of frames."""

    def __init__(self, net: nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: Tensor, windows: Tensor, dt_s: Tensor) -> Tensor:
        """Return what it says at each window's end [W], of frames [B,F]; its own clock takes a step as nominal."""
        said: Tensor = self.net(x[windows])[0][:, -1, 0]
        return said


class _Ours(nn.Module):
    def __init__(self, cell: RecurrentCell) -> None:
        super().__init__()
        self.cell = cell

    def forward(self, x: Tensor, windows: Tensor, dt_s: Tensor) -> Tensor:
        said: Tensor = self.cell(self.cell.sense(x)[windows], dt_s)[0][:, -1, 0]
        return said


def _ours(cell: RecurrentCell) -> nn.Module:
    return _Ours(cell)


def _compare(device: str, ours: nn.Module, peer: nn.Module, what: str) -> Row:
    torch.manual_seed(0)
    x = torch.randn(WINDOWS + WINDOW - 1, FEATURES, device=device)
    windows = torch.arange(WINDOWS, device=device)[:, None] + torch.arange(WINDOW, device=device)
    dt_s = torch.full((WINDOWS, WINDOW), NOMINAL_STEP_S, device=device)
    wanted = torch.randn(WINDOWS, device=device)

    def step(net: Any) -> Callable[[], None]:
        def many() -> None:
            for _ in range(TIMES):
                net.zero_grad()
                (net(x, windows, dt_s) - wanted).square().sum().backward()

        return many

    text = f"{WINDOWS} windows of {WINDOW}, {FEATURES} features: {what}, forward + backward"
    return compare(ms(step(ours.to(device)), TIMES), ms(step(peer.to(device)), TIMES), "ms", text)


TIMES = 10
