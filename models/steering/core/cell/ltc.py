"""Liquid time-constant cell (Hasani et al. 2021) on a sparse wiring: with `wiring.ncp`, a neural
circuit policy.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn.functional import softplus

from models.steering.core.recurrent import NOMINAL_STEP_S, OUTPUT_SCALE, RecurrentCell
from models.steering.core.wiring import Wiring

EPSILON = 1e-8


class LTC(RecurrentCell):
    """Neurons with potentials v [W,U]; each frame is `unfolds` semi-implicit Euler steps of

        v ← (c v + g v_leak + Σ w σ(s (v_pre - μ)) e) / (c + g + Σ w σ(s (v_pre - μ)) + ε),   c = cm
        unfolds / dt,

    where the sums run over internal and sensory synapses. The internal sums change at each step,
    the sensory ones once per frame: `project_inputs` computes them. The equation is from ncps
    1.0.1; here dt differs per window and frame, and only existing synapses are parameters. The
    motor neurons' potentials, scaled and shifted, are the output.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor, self.unfolds = wiring.motor, unfolds
        self.input_scale, self.input_shift = (
            nn.Parameter(torch.ones(inputs)),
            nn.Parameter(torch.zeros(inputs)),
        )
        self.sensory, self.internal = Synapses(wiring.sensory), Synapses(wiring.internal)
        # ncps draws cm between 0.4 and 0.6, a memory of about one frame. A single frame says
        # little: from the features of eight, a linear regression has half of the error that it has
        # from the last.
        capacity = torch.empty(units).uniform_(math.log(0.5), math.log(20.0)).exp()  # cm
        self.capacity = nn.Parameter(inverse_softplus(capacity))  # before softplus
        # g, before softplus
        self.leak = nn.Parameter(inverse_softplus(torch.empty(units).uniform_(0.001, 1.0)))
        self.rest = nn.Parameter(torch.empty(units).uniform_(-0.2, 0.2))  # v_leak
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.zeros(wiring.motor))

    def project_inputs(self, x: Tensor) -> Tensor:
        slope, threshold, sums = self.sensory.matrices()
        # [..., synapses]
        open_ = torch.sigmoid((x * self.input_scale + self.input_shift) @ slope - threshold)
        return open_ @ sums  # [..., 2U], Σ w σ e ‖ Σ w σ

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        leak = softplus(self.leak)
        c = softplus(self.capacity) * (self.unfolds * NOMINAL_STEP_S / dt_s[..., None])  # [W,T,U]
        # numerator ‖ denominator, [W,T,2U]
        fixed = projected + torch.cat([leak * self.rest, leak + EPSILON])
        potentials: Tensor = Unfolded.apply(  # type: ignore[no-untyped-call]
            c, fixed, *self.internal.matrices(), self.internal.place, self.unfolds
        )
        return potentials[..., : self.motor] * self.output_scale + self.output_shift


class Unfolded(torch.autograd.Function):
    """All K steps of all frames as one autograd operator with explicit gradients.

    On arrays this small, starting an operator costs more than its arithmetic. So backward has one
    product per step, with the Jacobians of all steps from a few operators on all of them.

    Args: c [W,T,U]; fixed [W,T,2U], the part of numerator ‖ denominator that is constant in a
    frame; slope [U,S],
        threshold [S] and sums [S,2U] of the internal synapses; place [S], their entries in a
        flattened matrix [U,U]; steps a frame. Returns v after each frame [W,T,U].
    """

    @staticmethod
    def forward(
        ctx: Any,
        c: Tensor,
        fixed: Tensor,
        slope: Tensor,
        threshold: Tensor,
        sums: Tensor,
        place: Tensor,
        unfolds: int,
    ) -> Tensor:
        fixed = torch.cat([fixed[..., : c.shape[2]], fixed[..., c.shape[2] :] + c], dim=2)
        # [W,S]; expanded, addmm is faster
        below, v = -threshold.expand(len(c), -1), torch.zeros_like(c[:, 0])
        potentials, opened, denominators = [v], [], []
        for c_frame, fixed_frame in zip(c.unbind(1), fixed.unbind(1), strict=True):
            for _ in range(unfolds):
                open_ = torch.addmm(below, v, slope).sigmoid_()  # [W,S]
                # each [W,U]
                numerator, denominator = torch.addmm(fixed_frame, open_, sums).chunk(2, dim=1)
                v = torch.addcmul(numerator, c_frame, v).div_(denominator)
                potentials.append(v)
                opened.append(open_)
                denominators.append(denominator)
        ctx.save_for_backward(c, slope, sums, place)
        ctx.steps = (potentials, opened, denominators) if any(ctx.needs_input_grad) else None
        return torch.stack(potentials[unfolds::unfolds], dim=1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_potentials: Tensor) -> tuple[Tensor | None, ...]:
        c, slope, sums, place = ctx.saved_tensors
        # [K+1,W,U], [K,W,S], [K,W,U]
        potentials, opened, denominators = map(torch.stack, ctx.steps)
        (steps, windows, units), frames = denominators.shape, c.shape[1]
        unfolds = steps // frames
        before, after = potentials[:-1], potentials[1:]
        inverse = denominators.reciprocal()
        # dv / d(numerator, denominator), [K,W,2,U]
        shares = torch.stack([inverse, -after * inverse], dim=2)
        sigmoid_backward = torch.ops.aten.sigmoid_backward
        # A column of slope has one entry.
        by_synapse = sigmoid_backward(shares.flatten(2) @ sums.T * slope.sum(0), opened)
        jacobian = c.new_zeros(steps, windows, units**2).scatter_(
            2, place.expand_as(by_synapse), by_synapse
        )
        # of v after a step [.., i, :] by v before it
        jacobian = jacobian.view(frames, unfolds, windows, units, units)
        inverse = inverse.view(frames, unfolds, windows, units)
        jacobian.diagonal(dim1=3, dim2=4).add_(inverse * c.transpose(0, 1)[:, None])
        transposed = jacobian.transpose(3, 4).flatten(0, 1)

        grad_frames = grad_potentials.transpose(0, 1)[:, :, None]  # [T,W,1,U]
        upstream = [grad_frames[-1]]  # of v after the last step, the one before, …, [W,1,U]
        for step in reversed(range(1, steps)):
            frame, within = divmod(step, unfolds)
            gradient, matrix = upstream[-1], transposed[step]
            if not within:  # v before the step is also the output of the frame before
                upstream.append(torch.baddbmm(grad_frames[frame - 1], gradient, matrix))
            else:
                upstream.append(torch.bmm(gradient, matrix))
        # of numerator ‖ denominator, [K,W,2U]
        grad_terms = (shares * torch.stack(upstream[::-1])).flatten(2)
        # of the argument of σ, [KW,S]
        grad_gates = sigmoid_backward(grad_terms @ sums.T, opened).flatten(0, 1)
        grad_c = torch.addcmul(grad_terms[..., units:], grad_terms[..., :units], before)
        grad_fixed, grad_c = (
            gradient.view(frames, unfolds, windows, -1).sum(1).transpose(0, 1)
            for gradient in (grad_terms, grad_c)
        )
        grad_slope, grad_sums = (
            before.flatten(0, 1).T @ grad_gates,
            opened.flatten(0, 1).T @ grad_terms.flatten(0, 1),
        )
        return grad_c, grad_fixed, grad_slope, -grad_gates.sum(0), grad_sums, None, None


class Synapses(nn.Module):
    """Parameters of the S synapses of a signed matrix [P,U], in row order."""

    pre: Tensor
    post: Tensor
    place: Tensor

    def __init__(self, polarity: np.ndarray) -> None:
        super().__init__()
        signs = torch.from_numpy(polarity).float()
        source, target = signs.nonzero().unbind(1)
        # [P,S], source
        self.register_buffer("pre", nn.functional.one_hot(source, len(signs)).T.float())
        # [S,U], target
        self.register_buffer("post", nn.functional.one_hot(target, signs.shape[1]).float())
        # [S], in the flattened matrix
        self.register_buffer("place", source * signs.shape[1] + target, persistent=False)
        # before softplus
        self.w = nn.Parameter(inverse_softplus(torch.empty(len(source)).uniform_(0.001, 1.0)))
        self.sigma = nn.Parameter(torch.empty(len(source)).uniform_(3.0, 8.0))
        self.mu = nn.Parameter(torch.empty(len(source)).uniform_(0.3, 0.8))
        self.erev = nn.Parameter(signs[source, target])  # reversal potential e, starts as the sign

    def matrices(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return slope [P,S], threshold [S], sums [S,2U]: σ(v @ slope - threshold) @ sums is Σ w σ
        e ‖ Σ w σ.
        """
        # The two dense products gather and scatter: for the 60 synapses of an NCP that is faster
        # than indexing.
        w = softplus(self.w)
        sums = torch.stack([w * self.erev, w], dim=1)[..., None] * self.post[:, None]  # [S,2,U]
        return self.pre * self.sigma, self.sigma * self.mu, sums.flatten(1)


def inverse_softplus(y: Tensor) -> Tensor:
    """Return x with softplus(x) = y, for y > 0."""
    return y + (-(-y).expm1()).log()
