import warnings

import numpy as np
import pytest
import torch

from models.steering.core.cell.cfc import CfC
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.wiring import Layout, ncp

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from ncps.torch import WiredCfCCell
    from ncps.wirings import Wiring as PeerWiring

TOLERANCE = {"rtol": 0, "atol": 1e-9}
HEADS = ["ff1", "ff2", "time_a", "time_b"]


class Layered(PeerWiring):
    """Our wiring as ncps describes it, with the layers inter, command and motor in this order."""

    def __init__(self, wiring):
        super().__init__(wiring.units)
        self.layers = np.split(np.arange(wiring.units), [wiring.motor, wiring.motor + wiring.command])[::-1]
        self.adjacency_matrix = wiring.internal.astype(np.int32)
        self.build(len(wiring.sensory))
        self.sensory_adjacency_matrix = wiring.sensory.astype(np.int32)
        self.set_output_dim(wiring.motor)

    @property
    def num_layers(self):
        return len(self.layers)

    def get_neurons_of_layer(self, layer_id):
        return self.layers[layer_id].tolist()


@pytest.mark.parametrize("motor", [1, 2])
def test_equals_ncps_forward_and_gradients(motor):
    torch.manual_seed(0)
    wiring = ncp(7, Layout(inter=6, command=5, sensory_fanout=3, inter_fanout=2, motor_fanin=3), motor=motor)
    ours, peer = CfC(wiring).double(), WiredCfCCell(None, Layered(wiring)).double()
    pairs = list(zip([ours.inter, ours.command, ours.motor], peer.children(), strict=True))
    with torch.no_grad():
        ours.output_scale.normal_()
        ours.output_shift.normal_()
        for layer, cell in pairs:
            for head, matrix, bias in zip(HEADS, layer.weight.dense().chunk(4, 1), layer.bias.chunk(4), strict=True):
                getattr(cell, head).weight.data, getattr(cell, head).bias.data = matrix.T.clone(), bias.clone()
    x = torch.randn(3, 5, 7, dtype=torch.float64, requires_grad=True)
    dt_s = torch.rand(3, 5, dtype=torch.float64) * 0.3 + 0.01  # irregular, and different in each window

    out, state = ours(ours.project_inputs(x), dt_s)
    hidden, outs = torch.zeros(3, wiring.units, dtype=torch.float64), []
    for t in range(5):
        motor_out, hidden = peer(x[:, t], hidden, dt_s[:, t, None] / NOMINAL_STEP_S)
        outs.append(motor_out * ours.output_scale + ours.output_shift)
    expected = torch.stack(outs, dim=1)
    torch.testing.assert_close(out, expected, **TOLERANCE)
    torch.testing.assert_close(torch.cat(state, dim=1), hidden, **TOLERANCE)

    upstream = torch.randn_like(out)
    theirs = [getattr(getattr(cell, head), kind) for _, cell in pairs for head in HEADS for kind in ("weight", "bias")]
    mine = [parameter for layer, _ in pairs for parameter in (layer.weight.w, layer.bias)]
    of_x, *gradients = torch.autograd.grad((out * upstream).sum() + torch.cat(state, dim=1).square().sum(), [x, *mine])
    of_x_peer, *peers = torch.autograd.grad((expected * upstream).sum() + hidden.square().sum(), [x, *theirs])
    torch.testing.assert_close(of_x, of_x_peer, **TOLERANCE)
    for number, (layer, _) in enumerate(pairs):
        of_w, of_bias = gradients[2 * number : 2 * number + 2]
        heads = peers[8 * number : 8 * number + 8]
        of_matrix = torch.cat([weight.T for weight in heads[::2]], dim=1)
        torch.testing.assert_close(of_w, of_matrix.flatten()[layer.weight.place], **TOLERANCE)
        torch.testing.assert_close(of_bias, torch.cat(heads[1::2]), **TOLERANCE)
        assert of_w.abs().min() > 0
