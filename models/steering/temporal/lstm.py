"""Long short-term memory (Hochreiter and Schmidhuber 1997)."""

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.options import Count, NetworkOptions, Sizes
from models.steering.core.recurrent import RecurrentCell


class Options(NetworkOptions):
    units: Count = Field(default=32, description="units of the cell")

    def build(self, sizes: Sizes) -> RecurrentCell:
        return LSTM(sizes.features, self, sizes.outputs)


class LSTM(RecurrentCell):
    """The cell of torch.nn.LSTM with a linear read-out; dt has no effect.

    The parameters, the order of the gates and the initialisation are those of torch.
    """

    def __init__(self, features: int, options: Options = Options(), outputs: int = 1) -> None:
        super().__init__()
        # Weights [4U,D] and [4U,U], and two biases [4U]. Each has the rows of gate i first, then
        # those of the gates f, g and o.
        reference = nn.LSTMCell(features, options.units)
        self.weight_ih = reference.weight_ih
        self.weight_hh = reference.weight_hh
        self.bias_ih = reference.bias_ih
        self.bias_hh = reference.bias_hh
        self.read_out = nn.Linear(options.units, outputs)

    def project_inputs(self, x: Tensor) -> Tensor:
        return nn.functional.linear(x, self.weight_ih, self.bias_ih + self.bias_hh)  # [..., 4U]

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        h = c = projected.new_zeros(len(projected), self.weight_hh.shape[1])
        hidden = []
        for frame in projected.unbind(1):
            gates = torch.addmm(frame, h, self.weight_hh.T)
            i, f, g, o = gates.chunk(4, dim=1)  # each [W,U]
            c = f.sigmoid() * c + i.sigmoid() * g.tanh()
            h = o.sigmoid() * c.tanh()
            hidden.append(h)
        return self.read_out(torch.stack(hidden, dim=1))
