"""What the recurrent networks share."""

from typing import Any

from torch import Tensor, nn

NOMINAL_STEP_S = 0.1  # KITTI's frame interval is one unit of a cell's time, as ncps has 1 per frame
# Outputs of a new cell stay within about ±1, standardised steering has sharp bends at 3 and more: from 1, as in ncps,
# the scale has to grow first, and training error after 8 epochs on synthetic streets was twice as large.
OUTPUT_REACH = 3.0
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
