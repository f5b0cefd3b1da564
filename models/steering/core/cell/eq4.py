"""The paper's eq. 4 as printed, on a sparse wiring. The cell that the paper cites is ltc.py."""

import torch
from torch import Tensor, nn

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_SCALE, RecurrentCell
from models.steering.core.wiring import SparseMatrix, Wiring

# Beyond e^±20 frames a neuron is instantaneous or frozen; float32 would overflow at e^88.
MAX_LOG_TAU = 20.0


class Eq4(RecurrentCell):
    """Neurons with states h [W,U] and input-dependent time constants (paper eq. 4):

        τ_i ḣ_i = -h_i + Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i,   τ_i = exp(θ_iᵀ x),   y_i = σ(h_i).

    σ is the logistic function; w exists where the wiring has a synapse and starts with its sign; θ
    is dense, as printed. The unit of time is the nominal frame (τ = 1 is 0.1 s), and x is constant
    over the dt before its frame. So τ is constant, and N(h) = Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i
    depends on h alone, which suits an exponential integrator, here ETD2RK (Cox and Matthews 2002).
    With z = dt / unfolds / τ each step is

        a = h + (1 - e^(-z)) (N(h) - h),   h ← a + (1 - (1 - e^(-z)) / z) (N(a) - N(h)),

    exact in leak and input, of second order in the recurrent sum, and stable for every dt and τ, as
    N is bounded. With 6 steps a frame, outputs of a new cell are within 3 % of their spread of the
    exact solution. Since y is in (0,1), motor neurons' y, scaled and shifted, are the output.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor, self.unfolds = wiring.motor, unfolds
        signs = [
            torch.from_numpy(polarity).float() for polarity in (wiring.sensory, wiring.internal)
        ]
        # |w| from U(0,1), as in the LTC cell
        self.sensory, self.internal = (
            SparseMatrix(sign * torch.rand(sign.shape), sign != 0) for sign in signs
        )
        self.bias = nn.Parameter(torch.zeros(units))
        self.theta = nn.Linear(inputs, units, bias=False)
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), 2 * OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.full((wiring.motor,), -OUTPUT_SCALE))

    def project_inputs(self, x: Tensor) -> Tensor:
        # [..., 2U], drive ‖ log τ
        return torch.cat([x @ self.sensory.dense() + self.bias, self.theta(x)], dim=-1)

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        internal = self.internal.dense()
        drive, log_tau = projected.chunk(2, dim=-1)  # each [W,T,U]
        h = torch.zeros_like(drive[:, 0])  # [W,U]
        z = (
            dt_s[..., None]
            / (NOMINAL_STEP_S * self.unfolds)
            / log_tau.clamp(-MAX_LOG_TAU, MAX_LOG_TAU).exp()
        )
        share = -torch.expm1(-z)  # relaxation of h towards N per step, [W,T,U]
        correction = 1 - share / z  # weight of N's change during the step, [W,T,U]
        states = []
        frames = zip(drive.unbind(1), share.unbind(1), correction.unbind(1), strict=True)
        for drive_frame, share_frame, correction_frame in frames:
            for _ in range(self.unfolds):
                n = torch.addmm(drive_frame, h.sigmoid(), internal)  # [W,U]
                a = torch.lerp(h, n, share_frame)
                h = torch.addcmul(
                    a, correction_frame, torch.addmm(drive_frame, a.sigmoid(), internal) - n
                )
            states.append(h)
        y = torch.stack(states, dim=1)[..., : self.motor].sigmoid()  # [W,T,motor]
        return y * self.output_scale + self.output_shift
