"""Interface of the recurrent networks.

The cells of `temporal: ncp` are files of cell/; temporal/ncp.py lists them.
"""

from typing import Any

from torch import Tensor, nn

# Unit of a cell's time in seconds: KITTI's frame interval, as a frame is one unit in ncps.
NOMINAL_STEP_S = 0.1
# Initial scale of a cell's outputs, which are within about ±1 before scaling. Standardised steering
# reaches 3 and more in sharp bends. With a scale of 1, as in ncps, the training error after 8
# epochs on synthetic streets was twice as large.
OUTPUT_SCALE = 3.0


class RecurrentCell(nn.Module):
    """Recurrent network from a window of frame features to R outputs per frame, 1 for an angle.

    It has two parts, so that windows share frames: `project_inputs` depends on a frame alone and
    runs once per frame; `forward` is the recursion and runs once per frame *and window*. Letters: W
    windows of T frames, D inputs, S values.
    """

    def project_inputs(self, x: Tensor) -> Tensor:
        """Return the per-frame part: [..., D] → [..., S]."""
        raise NotImplementedError

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        """Return the outputs [W,T,R] for `projected` [W,T,S] and time steps dt_s [W,T].

        The recursion starts from a state of zeros.
        """
        raise NotImplementedError

    __call__: Any  # nn.Module's, untyped
