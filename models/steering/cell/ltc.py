"""Liquid time-constant cell (Hasani et al. 2021) on a sparse wiring: with `wiring.ncp`, a neural circuit policy."""

import torch
from numpy import int8
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import softplus

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_REACH, RecurrentCell, State
from models.steering.core.wiring import Wiring

EPSILON = 1e-8


class LTC(RecurrentCell):
    """Neurons with potentials v [W,U]; each frame is `unfolds` semi-implicit Euler steps of

        v ← (c v + g v_leak + Σ w σ(s (v_pre - μ)) e) / (c + g + Σ w σ(s (v_pre - μ)) + ε),   c = cm unfolds / dt,

    where the sums run over internal and sensory synapses. The internal ones change at each step, the sensory ones
    only with the frame: they are `sense`. The equation is that of ncps 1.0.1; here dt differs per window and frame,
    and only synapses that exist are parameters. The motor neurons' potentials, scaled and shifted, are the output.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor, self.unfolds = wiring.motor, unfolds
        self.input_scale, self.input_shift = nn.Parameter(torch.ones(inputs)), nn.Parameter(torch.zeros(inputs))
        self.sensory, self.internal = Synapses(wiring.sensory), Synapses(wiring.internal)
        self.capacity = nn.Parameter(inverse_softplus(uniform(units, 0.4, 0.6)))  # cm, before softplus
        self.leak = nn.Parameter(inverse_softplus(uniform(units, 0.001, 1.0)))  # g, before softplus
        self.rest = nn.Parameter(uniform(units, -0.2, 0.2))  # v_leak
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), OUTPUT_REACH))
        self.output_shift = nn.Parameter(torch.zeros(wiring.motor))

    def sense(self, x: Tensor) -> Tensor:
        slope, threshold, sums = self.sensory.matrices()
        open_ = torch.sigmoid((x * self.input_scale + self.input_shift) @ slope - threshold)  # [..., synapses]
        return open_ @ sums  # [..., 2U], Σ w σ e ‖ Σ w σ

    def forward(self, sensed: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        slope, threshold, sums = self.internal.matrices()
        leak = softplus(self.leak)
        units = len(leak)
        (v,) = state or (sensed.new_zeros(len(sensed), units),)  # [W,U]
        # c as [W,T,U], and all that stays the same while a frame unfolds: numerator ‖ denominator, [W,T,2U]
        c = softplus(self.capacity) * self.unfolds * NOMINAL_STEP_S / dt_s[..., None]
        fixed = sensed + torch.cat([leak * self.rest, leak + EPSILON]) + torch.cat([torch.zeros_like(c), c], dim=-1)
        potentials = []
        for c_frame, fixed_frame in zip(c.unbind(1), fixed.unbind(1), strict=True):
            for _ in range(self.unfolds):
                open_ = torch.addmm(-threshold, v, slope).sigmoid_()  # [W, synapses]
                numerator, denominator = torch.addmm(fixed_frame, open_, sums).chunk(2, dim=1)  # each [W,U]
                v = torch.addcmul(numerator, c_frame, v) / denominator
            potentials.append(v)
        motor = torch.stack(potentials, dim=1)[..., : self.motor]  # [W,T,motor]
        return motor * self.output_scale + self.output_shift, (v,)


class Synapses(nn.Module):
    """The synapses of a signed matrix [P,U] as lists of S parameters, in row order."""

    pre: Tensor
    post: Tensor

    def __init__(self, polarity: NDArray[int8]) -> None:
        super().__init__()
        signs = torch.from_numpy(polarity).float()
        source, target = signs.nonzero().unbind(1)
        self.register_buffer("pre", nn.functional.one_hot(source, len(signs)).T.float())  # [P,S]: who is listened to
        self.register_buffer("post", nn.functional.one_hot(target, signs.shape[1]).float())  # [S,U]: who listens
        count = len(source)
        self.w = nn.Parameter(inverse_softplus(uniform(count, 0.001, 1.0)))  # before softplus
        self.sigma = nn.Parameter(uniform(count, 3.0, 8.0))
        self.mu = nn.Parameter(uniform(count, 0.3, 0.8))
        self.erev = nn.Parameter(signs[source, target])  # reversal potential e, starts as the sign

    def matrices(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return slope [P,S], threshold [S], sums [S,2U]: σ(v @ slope - threshold) @ sums is Σ w σ e ‖ Σ w σ.

        Gathering and scattering as two small dense products: with the 60 synapses of an NCP that is fewer and faster
        operations than indexing.
        """
        w = softplus(self.w)
        sums = torch.cat([(w * self.erev)[:, None] * self.post, w[:, None] * self.post], dim=1)
        return self.pre * self.sigma, self.sigma * self.mu, sums


def uniform(count: int, low: float, high: float) -> Tensor:
    """Return [count] numbers drawn between low and high."""
    return torch.empty(count).uniform_(low, high)


def inverse_softplus(y: Tensor) -> Tensor:
    """Return x with softplus(x) = y, for y > 0: parameters start where the literature has them."""
    return y + (-(-y).expm1()).log()


cell = LTC
