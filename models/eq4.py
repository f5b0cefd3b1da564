"""The paper's eq. 4 as printed, on a sparse wiring. The cell that the paper cites and names is `models.ltc`."""

import torch
from torch import Tensor, nn

from models.ltc import NOMINAL_STEP_S, OUTPUT_REACH
from models.recurrent import RecurrentCell, State
from models.sparse_matrix import SparseMatrix
from models.wiring import Wiring

# Beyond e^±20 frames a neuron is a wire or is frozen, whatever the exponent; float32 would overflow at e^88.
LOG_TAU_REACH = 20.0


class Eq4(RecurrentCell):
    """Neurons with states h [W,U] and time constants that the input sets (paper eq. 4):

        τ_i ḣ_i = -h_i + Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i,   τ_i = exp(θ_iᵀ x),   y_i = σ(h_i).

    σ is the logistic function; w exists where the wiring has a synapse and starts with its sign; θ is dense, as
    printed. Time counts in nominal frames (τ = 1 is 0.1 s), and a frame's x holds for all of the dt that leads to it.
    τ is constant there, so the integrator can be exponential Euler: with z = dt / unfolds / τ, each of `unfolds` steps

        h ← h + (1 - e^(-z)) (Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i - h),

    exact in leak and input, of first order in the recurrent sum, and stable for every dt and τ, however short: h only
    moves towards where it is drawn. Since y is in (0,1), motor neurons' y, scaled and shifted, are the output.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor, self.unfolds = wiring.motor, unfolds
        signs = [torch.from_numpy(polarity).float() for polarity in (wiring.sensory, wiring.internal)]
        # |w| from U(0,1), as that of the LTC cell
        self.sensory, self.internal = (SparseMatrix(sign * torch.rand(sign.shape), sign != 0) for sign in signs)
        self.bias = nn.Parameter(torch.zeros(units))
        self.theta = nn.Linear(inputs, units, bias=False)
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), 2 * OUTPUT_REACH))
        self.output_shift = nn.Parameter(torch.full((wiring.motor,), -OUTPUT_REACH))

    def sense(self, x: Tensor) -> Tensor:
        return torch.cat([x @ self.sensory.dense() + self.bias, self.theta(x)], dim=-1)  # [..., 2U], drive ‖ log τ

    def forward(self, sensed: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        internal = self.internal.dense()
        drive, log_tau = sensed.chunk(2, dim=-1)  # each [W,T,U]
        (h,) = state or (torch.zeros_like(drive[:, 0]),)  # [W,U]
        z = dt_s[..., None] / (NOMINAL_STEP_S * self.unfolds) / log_tau.clamp(-LOG_TAU_REACH, LOG_TAU_REACH).exp()
        share = -torch.expm1(-z)  # of the way to where h is drawn, [W,T,U]
        states = []
        for drive_frame, share_frame in zip(drive.unbind(1), share.unbind(1), strict=True):
            for _ in range(self.unfolds):
                h = torch.lerp(h, torch.addmm(drive_frame, h.sigmoid(), internal), share_frame)
            states.append(h)
        y = torch.stack(states, dim=1)[..., : self.motor].sigmoid()  # [W,T,motor]
        return y * self.output_scale + self.output_shift, (h,)
