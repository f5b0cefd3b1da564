"""The paper's eq. 4 as printed, on a sparse wiring. ltc.py has the cell that the paper cites."""

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_SCALE, RecurrentCell
from models.steering.core.wiring import SparseMatrix, Wiring

# Largest |log τ|, with τ in frames. A neuron with τ < e^-20 is instantaneous, with τ > e^20 frozen.
# float32 would overflow at e^88.
MAX_LOG_TAU = 20.0


class Eq4(RecurrentCell):
    """U neurons with states h [W,U] and input-dependent time constants (paper eq. 4):

        τ_i ḣ_i = -h_i + Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i,   τ_i = exp(θ_iᵀ x),   y_i = σ(h_i).

    σ is the logistic function. w_ij exists where the wiring has a synapse, and starts with the
    synapse's sign. θ is dense, as printed. The unit of time is the nominal frame: τ = 1 is 0.1 s.
    x is constant during the dt before its frame. So τ is constant, too, and
    N(h) = Σ_j w_ij σ(h_j) + Σ_k w_ik x_k + b_i depends on h alone. This suits an exponential
    integrator, here ETD2RK (Cox and Matthews 2002). With z = dt / unfolds / τ each step is

        a = h + (1 - e^(-z)) (N(h) - h),   h ← a + (1 - (1 - e^(-z)) / z) (N(a) - N(h)),

    which is exact in leak and input, of second order in the recurrent sum, and stable for every dt
    and τ, since N is bounded. With 6 steps per frame, outputs of a new cell differ from the exact
    solution by at most 3 % of their spread. The outputs are the y of the motor neurons, which are
    the first of the U. Since y is in (0,1), it is scaled and shifted, at first to ±OUTPUT_SCALE.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor = wiring.motor
        self.unfolds = unfolds
        self.sensory = random_weights(wiring.sensory)
        self.internal = random_weights(wiring.internal)
        self.bias = nn.Parameter(torch.zeros(units))
        self.theta = nn.Linear(inputs, units, bias=False)
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), 2 * OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.full((wiring.motor,), -OUTPUT_SCALE))

    def project_inputs(self, x: Tensor) -> Tensor:
        drive = x @ self.sensory.dense() + self.bias
        log_tau = self.theta(x)
        return torch.cat([drive, log_tau], dim=-1)  # [..., 2U]

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        internal = self.internal.dense()
        drive, log_tau = projected.chunk(2, dim=-1)  # each [W,T,U]

        # Length of a step in units of τ, relaxation of h towards N in a step, and weight of N's
        # change during the step, each [W,T,U].
        tau = log_tau.clamp(-MAX_LOG_TAU, MAX_LOG_TAU).exp()
        z = dt_s[..., None] / (NOMINAL_STEP_S * self.unfolds) / tau
        share = -torch.expm1(-z)
        correction = 1 - share / z

        h = torch.zeros_like(drive[:, 0])  # [W,U]
        states = []
        frames = zip(drive.unbind(1), share.unbind(1), correction.unbind(1), strict=True)
        for drive_frame, share_frame, correction_frame in frames:
            for _ in range(self.unfolds):
                n_h = torch.addmm(drive_frame, h.sigmoid(), internal)  # [W,U]
                a = torch.lerp(h, n_h, share_frame)
                n_a = torch.addmm(drive_frame, a.sigmoid(), internal)
                h = torch.addcmul(a, correction_frame, n_a - n_h)
            states.append(h)
        y = torch.stack(states, dim=1)[..., : self.motor].sigmoid()  # [W,T,motor]
        return y * self.output_scale + self.output_shift


def random_weights(polarity: np.ndarray) -> SparseMatrix:
    """Return weights with the signs of `polarity`, and |w| from U(0,1) as in the LTC cell."""
    signs = torch.from_numpy(polarity).float()
    return SparseMatrix(signs * torch.rand(signs.shape), signs != 0)
