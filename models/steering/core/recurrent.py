"""Interface of the recurrent networks.

The cells of `temporal: ncp` are files of cell/; temporal/ncp.py lists them.
"""

from typing import Any

from torch import Tensor, nn

# Unit of a cell's time in seconds. It is KITTI's frame interval, since ncps counts time in frames.
NOMINAL_STEP_S = 0.1
# Initial factor on a cell's outputs, which are within about ±1 before. Standardised steering is 3
# and more in sharp bends. With a factor of 1, as in ncps, the training error after 8 epochs on
# synthetic streets was twice as large.
OUTPUT_SCALE = 3.0


class RecurrentCell(nn.Module):
    """Recurrent network from the features of a window's frames to R outputs per frame.

    R is 1 for an angle. The network has two parts, because windows share frames. `project_inputs`
    depends on a frame alone and runs once per frame. `forward` is the recursion and runs once per
    frame *and window*. Letters: W windows of T frames, D inputs and S projected values per frame.
    """

    def project_inputs(self, x: Tensor) -> Tensor:
        """Return the projected values of each frame: [..., D] → [..., S]."""
        raise NotImplementedError

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        """Return the outputs [W,T,R] for `projected` [W,T,S] and time steps dt_s [W,T].

        The recursion starts from a state of zeros.
        """
        raise NotImplementedError

    __call__: Any  # nn.Module's, untyped
