"""Liquid time-constant cell (Hasani et al. 2021) on a sparse wiring: with `wiring.ncp`, a neural circuit policy."""

from typing import Any

import torch
from numpy import int8
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import softplus

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_SCALE, RecurrentCell, State
from models.steering.core.wiring import Wiring

EPSILON = 1e-8


class LTC(RecurrentCell):
    """Neurons with potentials v [W,U]; each frame is `unfolds` semi-implicit Euler steps of

        v ← (c v + g v_leak + Σ w σ(s (v_pre - μ)) e) / (c + g + Σ w σ(s (v_pre - μ)) + ε),   c = cm unfolds / dt,

    where the sums run over internal and sensory synapses. The internal sums change at each step, the sensory ones once
    per frame: `project_inputs` computes them. The equation is from ncps 1.0.1; here dt differs per window and frame,
    and only existing synapses are parameters. The motor neurons' potentials, scaled and shifted, are the output.
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
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.zeros(wiring.motor))

    def project_inputs(self, x: Tensor) -> Tensor:
        slope, threshold, sums = self.sensory.matrices()
        open_ = torch.sigmoid((x * self.input_scale + self.input_shift) @ slope - threshold)  # [..., synapses]
        return open_ @ sums  # [..., 2U], Σ w σ e ‖ Σ w σ

    def forward(self, projected: Tensor, dt_s: Tensor, state: State | None = None) -> tuple[Tensor, State]:
        leak = softplus(self.leak)
        (v,) = state or (projected.new_zeros(len(projected), len(leak)),)  # [W,U]
        c = softplus(self.capacity) * self.unfolds * NOMINAL_STEP_S / dt_s[..., None]  # [W,T,U]
        fixed = projected + torch.cat([leak * self.rest, leak + EPSILON])  # numerator ‖ denominator, [W,T,2U]
        unfolded: tuple[Tensor, Tensor] = Unfolded.apply(  # type: ignore[no-untyped-call]
            v, c, fixed, *self.internal.matrices(), self.unfolds
        )
        potentials, v = unfolded
        return potentials[..., : self.motor] * self.output_scale + self.output_shift, (v,)


class Unfolded(torch.autograd.Function):
    """All steps of all frames as one autograd operator with explicit gradients.

    On arrays this small, autograd's bookkeeping costs more than the operators. Parameter gradients are summed over all
    steps at once.

    Args: v [W,U] before; c [W,T,U]; fixed [W,T,2U], the part of numerator ‖ denominator that is constant in a frame;
        slope [U,S], threshold [S] and sums [S,2U] of the internal synapses; steps a frame.
    Returns: v after each frame [W,T,U], and after the last one [W,U].
    """

    @staticmethod
    def forward(
        ctx: Any, v: Tensor, c: Tensor, fixed: Tensor, slope: Tensor, threshold: Tensor, sums: Tensor, unfolds: int
    ) -> tuple[Tensor, Tensor]:
        fixed = torch.cat([fixed[..., : c.shape[2]], fixed[..., c.shape[2] :] + c], dim=2)
        below = -threshold.expand(len(v), -1)  # [W,S]; expanded, addmm is faster
        potentials, opened, denominators = [v], [], []
        for c_frame, fixed_frame in zip(c.unbind(1), fixed.unbind(1), strict=True):
            for _ in range(unfolds):
                open_ = torch.addmm(below, v, slope).sigmoid_()  # [W,S]
                numerator, denominator = torch.addmm(fixed_frame, open_, sums).chunk(2, dim=1)  # each [W,U]
                v = torch.addcmul(numerator, c_frame, v).div_(denominator)
                potentials.append(v)
                opened.append(open_)
                denominators.append(denominator)
        ctx.save_for_backward(c, slope, sums)
        ctx.steps = (potentials, opened, denominators) if any(ctx.needs_input_grad) else None
        # The returned tensors must not be the saved ones: that would be a reference cycle.
        return torch.stack(potentials[unfolds::unfolds], dim=1), v.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_potentials: Tensor, grad_last: Tensor) -> tuple[Tensor | None, ...]:
        c, slope, sums = ctx.saved_tensors
        potentials, opened, denominators = ctx.steps
        windows, frames, units = c.shape
        unfolds = len(opened) // frames
        sign = sums.new_ones(2 * units)
        sign[units:] = -1  # the denominator enters with a minus
        slope_t, sums_t = slope.T.contiguous(), (sums * sign).T.contiguous()
        c_frames, grad_frames = c.unbind(1), grad_potentials.unbind(1)
        upstream, grad_terms, grad_gates = grad_last, [], []
        for step in reversed(range(len(opened))):
            frame, within = divmod(step, unfolds)
            if within == unfolds - 1:
                upstream = upstream + grad_frames[frame]
            grad_numerator = upstream / denominators[step]
            grad_term = torch.cat(
                [grad_numerator, grad_numerator * potentials[step + 1]], dim=1
            )  # [W,2U], up to the sign
            grad_gate = torch.ops.aten.sigmoid_backward(grad_term @ sums_t, opened[step])  # [W,S], of the argument of σ
            upstream = torch.addmm(grad_numerator * c_frames[frame], grad_gate, slope_t)
            grad_terms.append(grad_term)
            grad_gates.append(grad_gate)
        before, open_ = torch.cat(potentials[:-1]), torch.cat(opened)  # [N W, …] for N steps
        grad_term, grad_gate = torch.cat(grad_terms[::-1]) * sign, torch.cat(grad_gates[::-1])
        grad_c = torch.addcmul(grad_term[:, units:], grad_term[:, :units], before)
        grad_fixed, grad_c = (
            gradient.view(frames, unfolds, windows, -1).sum(1).transpose(0, 1) for gradient in (grad_term, grad_c)
        )
        return upstream, grad_c, grad_fixed, before.T @ grad_gate, -grad_gate.sum(0), open_.T @ grad_term, None


class Synapses(nn.Module):
    """Parameters of the S synapses of a signed matrix [P,U], in row order."""

    pre: Tensor
    post: Tensor

    def __init__(self, polarity: NDArray[int8]) -> None:
        super().__init__()
        signs = torch.from_numpy(polarity).float()
        source, target = signs.nonzero().unbind(1)
        self.register_buffer("pre", nn.functional.one_hot(source, len(signs)).T.float())  # [P,S], source
        self.register_buffer("post", nn.functional.one_hot(target, signs.shape[1]).float())  # [S,U], target
        count = len(source)
        self.w = nn.Parameter(inverse_softplus(uniform(count, 0.001, 1.0)))  # before softplus
        self.sigma = nn.Parameter(uniform(count, 3.0, 8.0))
        # ncps draws thresholds between .3 and .8, for inputs in [0,1]. Features and potentials here are centred at 0,
        # where such synapses are nearly closed: a plain network learned turns to one side 6 epochs before the other.
        self.mu = nn.Parameter(uniform(count, -0.25, 0.25))
        self.erev = nn.Parameter(signs[source, target])  # reversal potential e, starts as the sign

    def matrices(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return slope [P,S], threshold [S], sums [S,2U]: σ(v @ slope - threshold) @ sums is Σ w σ e ‖ Σ w σ.

        Two small dense products gather and scatter: for the 60 synapses of an NCP that is faster than indexing.
        """
        w = softplus(self.w)
        sums = torch.cat([(w * self.erev)[:, None] * self.post, w[:, None] * self.post], dim=1)
        return self.pre * self.sigma, self.sigma * self.mu, sums


def uniform(count: int, low: float, high: float) -> Tensor:
    """Return [count] uniform random numbers between low and high."""
    return torch.empty(count).uniform_(low, high)


def inverse_softplus(y: Tensor) -> Tensor:
    """Return x with softplus(x) = y, for y > 0."""
    return y + (-(-y).expm1()).log()
