"""Closed-form continuous-time cell (Hasani et al. 2022) on a neural circuit policy's wiring."""

import numpy as np
import torch
from numpy import int8
from numpy.typing import NDArray
from torch import Tensor, nn

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_SCALE, RecurrentCell
from models.steering.core.wiring import SparseMatrix, Wiring


class CfC(RecurrentCell):
    """Three layers, inter → command → motor; each gets the layer below, u, and its own previous state, h:

        h ← (1 - gate) tanh(f) + gate tanh(g),   gate = σ(a dt + b),   f, g, a, b affine in u ‖ h,   dt in 0.1 s.

    As in ncps 1.0.1, f and g get u along the wiring's synapses only, a and b get all of u, and each neuron gets the
    state of its complete layer. The wiring's signs and its recurrent command synapses are not used. The motor neurons'
    states, scaled and shifted, are the output.
    """

    def __init__(self, wiring: Wiring) -> None:
        super().__init__()
        motor, command, inter = np.split(np.arange(wiring.units), [wiring.motor, wiring.motor + wiring.command])
        self.inputs = len(wiring.sensory)
        self.inter = Layer(wiring.sensory[:, inter])
        self.command = Layer(wiring.internal[np.ix_(inter, command)])
        self.motor = Layer(wiring.internal[np.ix_(command, motor)])
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.zeros(wiring.motor))

    def project_inputs(self, x: Tensor) -> Tensor:
        return x @ self.inter.weight.dense()[: self.inputs] + self.inter.bias  # [..., 4 inter], share of f ‖ g ‖ a ‖ b

    def forward(self, projected: Tensor, dt_s: Tensor) -> tuple[Tensor, Tensor]:
        layers = [self.inter, self.command, self.motor]
        weights = [layer.weight.dense() for layer in layers]
        inter, command, motor = (projected.new_zeros(len(projected), layer.neurons) for layer in layers)
        out = []
        for frame, dt in zip(projected.unbind(1), (dt_s[..., None] / NOMINAL_STEP_S).unbind(1), strict=True):
            inter = closed_form(torch.addmm(frame, inter, weights[0][self.inputs :]), dt)  # [W, inter]
            below = torch.cat([inter, command], dim=1)
            command = closed_form(torch.addmm(self.command.bias, below, weights[1]), dt)  # [W, command]
            below = torch.cat([command, motor], dim=1)
            motor = closed_form(torch.addmm(self.motor.bias, below, weights[2]), dt)  # [W, motor]
            out.append(motor)
        state = torch.cat([inter, command, motor], dim=1)
        return torch.stack(out, dim=1) * self.output_scale + self.output_shift, state


class Layer(nn.Module):
    """Weights of f ‖ g ‖ a ‖ b of H neurons with `synapses` [P,H] from P others: weight [P+H,4H], bias [4H]."""

    def __init__(self, synapses: NDArray[int8]) -> None:
        super().__init__()
        others, self.neurons = synapses.shape
        inputs = others + self.neurons
        exists = torch.ones(inputs, 4 * self.neurons, dtype=torch.bool)
        exists[:others, : 2 * self.neurons] = torch.from_numpy(synapses != 0).repeat(1, 2)
        xavier = (6 / (inputs + self.neurons)) ** 0.5  # for each of the four, synapse or not, as in ncps
        self.weight = SparseMatrix(torch.empty(exists.shape).uniform_(-xavier, xavier), exists)
        self.bias = nn.Parameter(torch.empty(4 * self.neurons).uniform_(-(inputs**-0.5), inputs**-0.5))


def closed_form(affine: Tensor, dt: Tensor) -> Tensor:
    """Return the new states [W,H] from f ‖ g ‖ a ‖ b [W,4H] and dt [W,1], in frames."""
    f, g, a, b = affine.chunk(4, dim=1)
    return torch.lerp(f.tanh(), g.tanh(), (a * dt + b).sigmoid())
