import warnings

import numpy as np
import pytest
import torch

from models.steering.core.cell.ltc import LTC, Unfolded
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.wiring import Layout, ncp

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from ncps.torch import LTCCell
    from ncps.wirings import Wiring as PeerWiring

TOLERANCE = {"rtol": 0, "atol": 1e-9}
SYNAPSE = {"w": "w", "sigma": "sigma", "mu": "mu", "erev": "erev"}
NEURON = {"capacity": "cm", "leak": "gleak", "rest": "vleak"}
MAP = {"input_scale": "input_w", "input_shift": "input_b", "output_scale": "output_w", "output_shift": "output_b"}


def pair(wiring):
    """Our cell and ncps's with the same wiring and weights; yields (our parameter, theirs, which of theirs)."""
    ours = LTC(wiring).double()
    with torch.no_grad():
        for parameter in (ours.input_scale, ours.input_shift, ours.output_scale, ours.output_shift):
            parameter.normal_()
    same = PeerWiring(wiring.units)
    same.adjacency_matrix = wiring.internal.astype(np.int32)
    same.build(len(wiring.sensory))
    same.sensory_adjacency_matrix = wiring.sensory.astype(np.int32)
    same.set_output_dim(wiring.motor)
    peer = LTCCell(same, implicit_param_constraints=True).double()

    matches = []
    for synapses, signs, prefix in [(ours.sensory, wiring.sensory, "sensory_"), (ours.internal, wiring.internal, "")]:
        matches += [
            (getattr(synapses, name), getattr(peer, prefix + theirs), signs.nonzero())
            for name, theirs in SYNAPSE.items()
        ]
    matches += [(getattr(ours, name), getattr(peer, theirs), ...) for name, theirs in (NEURON | MAP).items()]
    for parameter, theirs, which in matches:
        theirs.data[which] = parameter.data
    return ours, peer, matches


@pytest.mark.parametrize("motor", [1, 2])
def test_equals_ncps_forward_and_gradients(motor):
    torch.manual_seed(0)
    wiring = ncp(7, Layout(inter=6, command=5, sensory_fanout=3, inter_fanout=2, motor_fanin=3), motor=motor)
    ours, peer, matches = pair(wiring)
    x = torch.randn(3, 5, 7, dtype=torch.float64, requires_grad=True)
    dt_s = torch.rand(3, 5, dtype=torch.float64) * 0.3 + 0.01  # irregular, and different in each window

    out, (v,) = ours(ours.project_inputs(x), dt_s)
    state, outs = torch.zeros(3, wiring.units, dtype=torch.float64), []
    for t in range(5):
        motor_out, state = peer(x[:, t], state, dt_s[:, t, None] / NOMINAL_STEP_S)
        outs.append(motor_out)
    expected = torch.stack(outs, dim=1)
    torch.testing.assert_close(out, expected, **TOLERANCE)
    torch.testing.assert_close(v, state, **TOLERANCE)

    upstream = torch.randn_like(out)
    gradients = torch.autograd.grad((out * upstream).sum() + v.square().sum(), [x, *(ours_ for ours_, _, _ in matches)])
    peers = torch.autograd.grad(
        (expected * upstream).sum() + state.square().sum(), [x, *(theirs for _, theirs, _ in matches)]
    )
    torch.testing.assert_close(gradients[0], peers[0], **TOLERANCE)
    for gradient, theirs, (_, _, which) in zip(gradients[1:], peers[1:], matches, strict=True):
        torch.testing.assert_close(gradient, theirs[which], **TOLERANCE)
        assert gradient.abs().max() > 1e-9


def inputs_of_steps(windows=3, frames=4, dtype=torch.float64):
    """v, c, fixed, slope, threshold, sums of a cell with a random wiring."""
    cell = LTC(ncp(5, Layout(inter=4, command=3, sensory_fanout=2, inter_fanout=2, motor_fanin=2))).to(dtype)
    units = len(cell.leak)
    v = torch.rand(windows, units, dtype=dtype)
    c = torch.rand(windows, frames, units, dtype=dtype) * 30 + 1
    fixed = cell.project_inputs(torch.randn(windows, frames, 5, dtype=dtype)) + 0.1
    return [each.detach().requires_grad_() for each in (v, c, fixed, *cell.internal.matrices())], cell.internal.place


def test_explicit_gradients():
    torch.manual_seed(0)
    inputs, place = inputs_of_steps(windows=2, frames=2)
    assert torch.autograd.gradcheck(lambda *tensors: Unfolded.apply(*tensors, place, 3), inputs)
