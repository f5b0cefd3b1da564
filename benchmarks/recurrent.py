"""Measure the liquid recurrent network beside the one of ncps."""

import warnings
from collections.abc import Callable

import torch
from torch import Tensor, nn

from benchmarks.row import DEVICE, Row, compare, milliseconds
from models.steering.core.cell.ltc import LTC
from models.steering.core.wiring import ncp

WINDOWS, WINDOW, FEATURES = 24, 8, 32
REPEATS = 10


def ltc() -> Row:
    """Compare LTC cells on windows that share frames, forward and backward."""
    torch.manual_seed(0)
    x = torch.randn(WINDOWS + WINDOW - 1, FEATURES, device=DEVICE)
    windows = torch.arange(WINDOWS, device=DEVICE)[:, None] + torch.arange(WINDOW, device=DEVICE)
    dt_s = torch.full((WINDOWS, WINDOW), 0.1, device=DEVICE)
    ours, alternative = LTC(ncp(FEATURES)).to(DEVICE), ncps_ltc(FEATURES).to(DEVICE)

    def forward_ours() -> Tensor:
        return ours(ours.sense(x)[windows], dt_s)[0]

    def forward_alternative() -> Tensor:
        return alternative(x[windows])[0]

    return compare(
        milliseconds(_repeat(forward_ours, ours), REPEATS),
        milliseconds(_repeat(forward_alternative, alternative), REPEATS),
        "ms",
        f"{WINDOWS} windows of {WINDOW} frames, {FEATURES} features: LTC / ncps LTC, forward + backward",
    )


def ncps_ltc(features: int) -> nn.Module:
    """Return the LTC network of ncps on a wiring of the same sizes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from ncps import torch as ncps_torch
        from ncps.wirings import NCP

    wiring = NCP(
        inter_neurons=12,
        command_neurons=6,
        motor_neurons=1,
        sensory_fanout=6,
        inter_fanout=4,
        recurrent_command_synapses=6,
        motor_fanin=6,
    )
    net: nn.Module = ncps_torch.LTC(features, wiring, batch_first=True)
    return net


def _repeat(forward: Callable[[], Tensor], net: nn.Module) -> Callable[[], None]:
    def work() -> None:
        for _ in range(REPEATS):
            net.zero_grad()
            forward()[:, -1, 0].square().sum().backward()  # type: ignore[no-untyped-call]

    return work
