"""Each recurrent network beside its oracle (torch, ncps, an ODE solver); the wiring."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from ncps.torch import LTCCell
from ncps.wirings import Wiring as PeerWiring
from scipy.integrate import solve_ivp
from scipy.special import expit

from models.steering.core.cell.eq4 import Eq4
from models.steering.core.cell.ltc import LTC
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.wiring import Layout, ncp
from models.steering.temporal import lstm

TOLERANCE = {"rtol": 0, "atol": 1e-9}
# Our parameter → that of ncps.
NAMES = {
    "capacity": "cm",
    "leak": "gleak",
    "rest": "vleak",
    "input_scale": "input_w",
    "input_shift": "input_b",
    "output_scale": "output_w",
    "output_shift": "output_b",
}
LAYOUT = Layout(inter=6, command=5, sensory_fanout=3, inter_fanout=2, motor_fanin=3)
# Irregular, and different in each window.
DT_S = torch.rand(3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
DT_S = 0.3 * DT_S + 0.01


def test_lstm_equals_torch():
    torch.manual_seed(0)
    cell = lstm.LSTM(5, lstm.Options(units=7)).double()
    peer = torch.nn.LSTM(5, 7, batch_first=True).double()
    for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh"):
        getattr(peer, f"{name}_l0").data = getattr(cell, name).data.clone()
    x = torch.randn(3, 6, 5, dtype=torch.float64)
    out = cell(cell.project_inputs(x), torch.full((3, 6), 0.1))
    expected = cell.read_out(peer(x)[0])
    torch.testing.assert_close(out, expected, **TOLERANCE)


class Peer(PeerWiring):
    """Our wiring as ncps describes it."""

    def __init__(self, wiring):
        super().__init__(len(wiring.internal))
        self.adjacency_matrix = wiring.internal.astype(np.int32)
        self.build(len(wiring.sensory))
        self.sensory_adjacency_matrix = wiring.sensory.astype(np.int32)
        self.set_output_dim(wiring.motor)


def pair(wiring):
    """Return our cell and ncps's with the same wiring and weights, and pairs of parameters.

    A pair is our parameter, theirs, and which elements of theirs it has.
    """
    ours = LTC(wiring).double()
    with torch.no_grad():
        for parameter in (ours.input_scale, ours.input_shift, ours.output_scale, ours.output_shift):
            parameter.normal_()
    peer = LTCCell(Peer(wiring), implicit_param_constraints=True).double()

    pairs = []
    for synapses, signs, prefix in [
        (ours.sensory, wiring.sensory, "sensory_"),
        (ours.internal, wiring.internal, ""),
    ]:
        for name in ("w", "sigma", "mu", "erev"):
            pairs.append((getattr(synapses, name), getattr(peer, prefix + name), signs.nonzero()))
    for name, theirs in NAMES.items():
        pairs.append((getattr(ours, name), getattr(peer, theirs), ...))
    for parameter, theirs, which in pairs:
        theirs.data[which] = parameter.data
    return ours, peer, pairs


@pytest.mark.parametrize("motor", [1, 2])
def test_ltc_equals_ncps_forward_and_gradients(motor):
    torch.manual_seed(0)
    wiring = ncp(7, LAYOUT, motor=motor)
    ours, peer, pairs = pair(wiring)
    x = torch.randn(3, 5, 7, dtype=torch.float64, requires_grad=True)

    out = ours(ours.project_inputs(x), DT_S)
    state = torch.zeros(3, len(wiring.internal), dtype=x.dtype)
    outs = []
    for frame, dt_s in zip(x.unbind(1), DT_S.unbind(1), strict=True):
        peer_out, state = peer(frame, state, dt_s[:, None] / NOMINAL_STEP_S)
        outs.append(peer_out)
    expected = torch.stack(outs, dim=1)
    torch.testing.assert_close(out, expected, **TOLERANCE)

    upstream = torch.randn_like(out)
    mine, theirs, places = zip(*pairs, strict=True)
    gradient_x, *gradients = torch.autograd.grad((out * upstream).sum(), [x, *mine])
    peer_x, *peer_gradients = torch.autograd.grad((expected * upstream).sum(), [x, *theirs])
    torch.testing.assert_close(gradient_x, peer_x, **TOLERANCE)
    for gradient, peer_gradient, which in zip(gradients, peer_gradients, places, strict=True):
        torch.testing.assert_close(gradient, peer_gradient[which], **TOLERANCE)
        assert gradient.abs().max() > 1e-9


DT_EQ4_S = torch.tensor([[0.1, 0.31, 0.02, 0.1], [0.08, 0.1, 0.12, 0.6]], dtype=torch.float64)
WIRING = ncp(5, LAYOUT, motor=2)


def cell_of(unfolds: int) -> Eq4:
    torch.manual_seed(0)
    cell = Eq4(WIRING, unfolds).double()
    with torch.no_grad():
        for parameter in cell.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return cell


def solved(cell: Eq4, x: np.ndarray, dt_s: np.ndarray) -> np.ndarray:
    """Return h after each of a window's frames, by a solver of order 8.

    Eq. 4 is written as sums over synapses.
    """
    bias = cell.bias.detach().numpy()
    theta = cell.theta.weight.detach().numpy()

    def slope(_, h, x_frame):
        change = bias - h
        for (k, i), w in zip(np.argwhere(WIRING.sensory), cell.sensory.w.tolist(), strict=True):
            change[i] += w * x_frame[k]
        for (j, i), w in zip(np.argwhere(WIRING.internal), cell.internal.w.tolist(), strict=True):
            change[i] += w * expit(h[j])
        return change / np.exp(theta @ x_frame)

    h = np.zeros(len(WIRING.internal))
    states = []
    for x_frame, dt in zip(x, dt_s, strict=True):
        solution = solve_ivp(
            slope, (0, dt / NOMINAL_STEP_S), h, "DOP853", args=(x_frame,), rtol=1e-12, atol=1e-13
        )
        h = solution.y[:, -1]
        states.append(h)
    return np.array(states)


def test_small_steps_of_eq4_reach_the_ode_solvers_solution():
    torch.manual_seed(1)
    x = torch.randn(2, 4, 5, dtype=torch.float64)
    windows = [solved(cell_of(1), x[w].numpy(), DT_EQ4_S[w].numpy()) for w in range(2)]
    exact = torch.from_numpy(np.stack(windows))
    errors = []
    for unfolds in (256, 512, 1024):
        cell = cell_of(unfolds)
        with torch.no_grad():
            out = cell(cell.project_inputs(x), DT_EQ4_S)
            y = exact[..., :2].sigmoid() * cell.output_scale + cell.output_shift
        errors.append((out - y).abs().max().item())
    # Second order: half the step, a quarter of the error.
    assert all(3.7 < coarse / fine < 4.3 for coarse, fine in itertools.pairwise(errors))
    assert errors[-1] < 1e-7


def test_default_is_the_wiring_of_the_paper():
    wiring = ncp(32)
    assert (wiring.motor, len(wiring.internal)) == (1, 1 + 6 + 12)
    command = slice(1, 7)
    inter = slice(7, 19)
    sensory = np.abs(wiring.sensory)
    internal = np.abs(wiring.internal)
    assert (sensory[:, inter].sum(1) == 6).all()
    assert (internal[inter, command].sum(1) == 4).all()
    assert internal[command, 0].sum() == internal[command, command].sum() == 6
    assert sensory.sum() == 32 * 6
    assert internal.sum() == 12 * 4 + 6 + 6


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 3), st.integers(1, 3))
def test_each_neuron_has_input_and_output(seed, inputs, fanout):
    fans = {"sensory_fanout": fanout, "inter_fanout": fanout, "motor_fanin": 2}
    wiring = ncp(inputs, Layout(inter=15, command=7, **fans, seed=seed), motor=2)
    commands = slice(2, 9)
    inters = slice(9, 24)
    assert wiring.sensory[:, inters].any(0).all()
    assert wiring.internal[inters, commands].any(0).all()
    assert wiring.internal[commands, :2].any(1).all()
    assert (np.abs(wiring.internal[commands, :2]).sum(0) >= 2).all()
