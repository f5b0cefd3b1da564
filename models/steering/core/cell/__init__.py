"""Interface of the recurrent networks, and the cells of `temporal: ncp`, one per file; temporal/ncp.py lists them."""

from typing import Any

import torch
from torch import Tensor, nn

NOMINAL_STEP_S = 0.1  # KITTI's frame interval is one unit of a cell's time, as ncps has 1 per frame
# A new cell's outputs are within about ±1 before scaling; standardised steering reaches 3 and more in sharp bends.
# With an initial scale of 1, as in ncps, training error after 8 epochs on synthetic streets was twice as large.
OUTPUT_SCALE = 3.0
State = tuple[Tensor, ...]


class RecurrentCell(nn.Module):
    """Recurrent network from a window of frame features to R numbers per frame, 1 for an angle.

    It has two parts, so that windows share frames: `project_inputs` depends on a frame alone and runs once per frame;
    `forward` is the recursion and runs once per frame *and window*. Letters: W windows, T frames each, D inputs per
    frame, S numbers from `project_inputs`.
    """

    def project_inputs(self, x: Tensor) -> Tensor:
        """Return the per-frame part: [..., D] → [..., S]."""
        raise NotImplementedError

    def forward(self, projected: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        """Run the recursion over frames `projected` [W,T,S], dt_s [W,T] seconds after the previous ones.

        Returns the numbers of each window and frame [W,T,R], and the state after the last frame. `state`: from an
        earlier call, to continue a window; None: zeros.
        """
        raise NotImplementedError

    def state_size(self, inputs: int) -> int:
        """Return U, the numbers in the state of one window, for `inputs` numbers per frame."""
        _, state = self.forward(self.project_inputs(torch.zeros(1, 1, inputs)), torch.full((1, 1), NOMINAL_STEP_S))
        return sum(part.shape[1] for part in state)

    __call__: Any  # nn.Module's, untyped
