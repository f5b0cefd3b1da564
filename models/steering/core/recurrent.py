"""Recurrent cells: what they share, and the LSTM."""

from typing import Any

import torch
from torch import Tensor, nn

State = tuple[Tensor, ...]


class RecurrentCell(nn.Module):
    """From a window of frame features to one number per frame.

    A cell is split in two, so that windows can share frames: `sense` is what depends on a frame alone and runs once
    per frame; `forward` is the recursion and runs once per frame *and window*. Letters: W windows, T frames each,
    D features, S numbers that `sense` gives.
    """

    def sense(self, x: Tensor) -> Tensor:
        """Return what the recursion needs of each frame: [..., D] → [..., S]."""
        raise NotImplementedError

    def forward(self, sensed: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        """Run over the frames.

        Args:
            sensed: [W,T,S] of `sense`.
            dt_s: [W,T] seconds since the frame before.
            state: what an earlier call returned; None is rest. Carried, pieces of a window give what the whole gives.
        Returns:
            One number per window and frame [W,T,1], and the state after the last frame.
        """
        raise NotImplementedError

    __call__: Any  # of nn.Module


class LSTM(RecurrentCell):
    """torch.nn.LSTM's cell (parameters, gate order and initialisation), with a linear read-out. It ignores dt."""

    def __init__(self, inputs: int, units: int) -> None:
        super().__init__()
        reference = nn.LSTMCell(inputs, units)
        self.weight_ih, self.weight_hh = reference.weight_ih, reference.weight_hh  # [4U,D], [4U,U]: gates i, f, g, o
        self.bias_ih, self.bias_hh = reference.bias_ih, reference.bias_hh  # [4U]
        self.read_out = nn.Linear(units, 1)

    def sense(self, x: Tensor) -> Tensor:
        return nn.functional.linear(x, self.weight_ih, self.bias_ih + self.bias_hh)  # [..., 4U]

    def forward(self, sensed: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        h, c = state or 2 * (sensed.new_zeros(len(sensed), self.weight_hh.shape[1]),)
        hidden = []
        for frame in sensed.unbind(1):
            i, f, g, o = torch.addmm(frame, h, self.weight_hh.T).chunk(4, dim=1)  # each [W,U]
            c = f.sigmoid() * c + i.sigmoid() * g.tanh()
            h = o.sigmoid() * c.tanh()
            hidden.append(h)
        return self.read_out(torch.stack(hidden, dim=1)), (h, c)
