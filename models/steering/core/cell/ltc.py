"""Liquid time-constant cell (Hasani et al. 2021) on a sparse wiring.

With the wiring of core/wiring.py it is a neural circuit policy.
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

# Added to the denominator, as in ncps.
EPSILON = 1e-8


class LTC(RecurrentCell):
    """Neurons with potentials v [W,U]; each frame is `unfolds` semi-implicit Euler steps of

        v ← (c v + g v_leak + Σ w σ(s (v_pre - μ)) e) / (c + g + Σ w σ(s (v_pre - μ)) + ε),
        c = cm unfolds / dt,

    where the sums run over internal and sensory synapses. The internal sums change in each step.
    The sensory sums are constant in a frame, so `project_inputs` computes them once. The equation
    is from ncps 1.0.1. Unlike there, dt may differ between windows and frames, and only existing
    synapses have parameters. The outputs are the potentials of the motor neurons, scaled and
    shifted.
    """

    def __init__(self, wiring: Wiring, unfolds: int = 6) -> None:
        super().__init__()
        inputs, units = wiring.sensory.shape
        self.motor = wiring.motor
        self.unfolds = unfolds
        self.input_scale = nn.Parameter(torch.ones(inputs))
        self.input_shift = nn.Parameter(torch.zeros(inputs))
        self.sensory = Synapses(wiring.sensory)
        self.internal = Synapses(wiring.internal)

        # cm and g, before softplus. ncps draws cm between 0.4 and 0.6, which is a memory of about a
        # frame. Here the memory is longer, since a single frame says little: a linear regression on
        # the features of eight frames has half the error of a regression on those of the last.
        capacity = torch.empty(units).uniform_(math.log(0.5), math.log(20.0)).exp()
        self.capacity = nn.Parameter(inverse_softplus(capacity))
        leak = torch.empty(units).uniform_(0.001, 1.0)
        self.leak = nn.Parameter(inverse_softplus(leak))

        self.rest = nn.Parameter(torch.empty(units).uniform_(-0.2, 0.2))  # v_leak
        self.output_scale = nn.Parameter(torch.full((wiring.motor,), OUTPUT_SCALE))
        self.output_shift = nn.Parameter(torch.zeros(wiring.motor))

    def project_inputs(self, x: Tensor) -> Tensor:
        slope, threshold, sums = self.sensory.matrices()
        v_pre = x * self.input_scale + self.input_shift
        open_ = torch.sigmoid(v_pre @ slope - threshold)  # [..., synapses]
        return open_ @ sums  # [..., 2U], Σ w σ e ‖ Σ w σ

    def forward(self, projected: Tensor, dt_s: Tensor) -> Tensor:
        leak = softplus(self.leak)
        capacity = softplus(self.capacity)
        c = capacity * (self.unfolds * NOMINAL_STEP_S / dt_s[..., None])  # [W,T,U]
        # numerator ‖ denominator, [W,T,2U]
        fixed = projected + torch.cat([leak * self.rest, leak + EPSILON])
        slope, threshold, sums = self.internal.matrices()
        potentials: Tensor = Unfolded.apply(  # type: ignore[no-untyped-call]
            c, fixed, slope, threshold, sums, self.internal.place, self.unfolds
        )
        return potentials[..., : self.motor] * self.output_scale + self.output_shift


class Unfolded(torch.autograd.Function):
    """All K steps of all frames as a single autograd operator with explicit gradients.

    On arrays this small, starting an operator takes longer than its arithmetic. So `backward`
    computes the Jacobians of all steps at once, by few operators, and then needs a single product
    per step.
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
        """Return v after each frame, [W,T,U].

        Args:
            c: [W,T,U].
            fixed: [W,T,2U], the part of numerator ‖ denominator that is constant in a frame.
            slope, threshold, sums: [U,S], [S] and [S,2U] of the internal synapses.
            place: [S], entries of the synapses in a flattened matrix [U,U].
            unfolds: steps per frame.
        """
        numerator, denominator = fixed.chunk(2, dim=2)
        fixed = torch.cat([numerator, denominator + c], dim=2)
        below = -threshold.expand(len(c), -1)  # [W,S]; expanded, addmm is faster
        v = torch.zeros_like(c[:, 0])

        # v after each step [W,U], and σ [W,S] and the denominator [W,U] of each step.
        potentials = [v]
        opened = []
        denominators = []
        for c_frame, fixed_frame in zip(c.unbind(1), fixed.unbind(1), strict=True):
            for _ in range(unfolds):
                open_ = torch.addmm(below, v, slope).sigmoid_()
                terms = torch.addmm(fixed_frame, open_, sums)
                numerator, denominator = terms.chunk(2, dim=1)
                v = torch.addcmul(numerator, c_frame, v).div_(denominator)
                potentials.append(v)
                opened.append(open_)
                denominators.append(denominator)

        if any(ctx.needs_input_grad):
            ctx.save_for_backward(c, slope, sums, place)
            ctx.steps = (potentials, opened, denominators)
        return torch.stack(potentials[unfolds::unfolds], dim=1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_potentials: Tensor) -> tuple[Tensor | None, ...]:
        c, slope, sums, place = ctx.saved_tensors
        potentials, opened, denominators = ctx.steps
        potentials = torch.stack(potentials)
        opened = torch.stack(opened)
        denominators = torch.stack(denominators)
        before = potentials[:-1]  # v before each step, [K,W,U]
        after = potentials[1:]
        steps, windows, units = denominators.shape
        frames = c.shape[1]
        unfolds = steps // frames

        # Derivatives of v after a step with respect to numerator and denominator, [K,W,2,U].
        inverse = denominators.reciprocal()
        shares = torch.stack([inverse, -after * inverse], dim=2)

        # Jacobians of all steps [K,W,U,U]: v after a step with respect to v before it. A synapse
        # contributes a single entry, since its column of slope has a single entry. The capacity
        # contributes to the diagonal.
        sigmoid_backward = torch.ops.aten.sigmoid_backward
        by_synapse = sigmoid_backward(shares.flatten(2) @ sums.T * slope.sum(0), opened)
        jacobian = c.new_zeros(steps, windows, units**2)
        jacobian.scatter_(2, place.expand_as(by_synapse), by_synapse)
        jacobian = jacobian.view(frames, unfolds, windows, units, units)
        inverse = inverse.view(frames, unfolds, windows, units)
        jacobian.diagonal(dim1=3, dim2=4).add_(inverse * c.transpose(0, 1)[:, None])
        transposed = jacobian.transpose(3, 4).flatten(0, 1)

        # Gradients [W,1,U] with respect to v after each step, from the last step to the first. v
        # after the last step of a frame is also an output, whose gradient is added.
        grad_frames = grad_potentials.transpose(0, 1)[:, :, None]  # [T,W,1,U]
        gradient = grad_frames[-1]
        gradients = [gradient]
        for step in reversed(range(1, steps)):
            if step % unfolds:
                gradient = torch.bmm(gradient, transposed[step])
            else:
                output = grad_frames[step // unfolds - 1]
                gradient = torch.baddbmm(output, gradient, transposed[step])
            gradients.append(gradient)
        upstream = torch.stack(gradients[::-1])

        # Gradients with respect to numerator ‖ denominator [K,W,2U], and to the argument of σ
        # [KW,S].
        grad_terms = (shares * upstream).flatten(2)
        grad_gates = sigmoid_backward(grad_terms @ sums.T, opened).flatten(0, 1)
        grad_slope = before.flatten(0, 1).T @ grad_gates
        grad_sums = opened.flatten(0, 1).T @ grad_terms.flatten(0, 1)

        # c is a factor in the numerator and a summand of the denominator. Inputs that are constant
        # in a frame get the sum of the gradients of its steps.
        grad_numerator, grad_denominator = grad_terms.chunk(2, dim=2)
        grad_c = torch.addcmul(grad_denominator, grad_numerator, before)
        grad_c = grad_c.view(frames, unfolds, windows, -1).sum(1).transpose(0, 1)
        grad_fixed = grad_terms.view(frames, unfolds, windows, -1).sum(1).transpose(0, 1)
        return grad_c, grad_fixed, grad_slope, -grad_gates.sum(0), grad_sums, None, None


class Synapses(nn.Module):
    """Parameters of the S synapses of a signed matrix [P,U], in row order."""

    pre: Tensor
    post: Tensor
    place: Tensor

    def __init__(self, polarity: np.ndarray) -> None:
        super().__init__()
        signs = torch.from_numpy(polarity).float()
        neurons, units = signs.shape
        source, target = signs.nonzero().unbind(1)
        pre = nn.functional.one_hot(source, neurons).T.float()
        post = nn.functional.one_hot(target, units).float()
        self.register_buffer("pre", pre)  # [P,S]
        self.register_buffer("post", post)  # [S,U]
        # Places [S] in the flattened matrix.
        self.register_buffer("place", source * units + target, persistent=False)

        w = torch.empty(len(source)).uniform_(0.001, 1.0)
        self.w = nn.Parameter(inverse_softplus(w))  # before softplus
        self.sigma = nn.Parameter(torch.empty(len(source)).uniform_(3.0, 8.0))
        self.mu = nn.Parameter(torch.empty(len(source)).uniform_(0.3, 0.8))
        self.erev = nn.Parameter(signs[source, target])  # reversal potential e, starts as the sign

    def matrices(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return slope [P,S], threshold [S] and sums [S,2U].

        With them, σ(v @ slope - threshold) @ sums is Σ w σ e ‖ Σ w σ. The first product gathers the
        inputs of synapses, the second adds their outputs. For the 60 synapses of an NCP, dense
        products are faster than indexing.
        """
        slope = self.pre * self.sigma
        threshold = self.sigma * self.mu
        w = softplus(self.w)
        weights = torch.stack([w * self.erev, w], dim=1)  # [S,2]
        sums = weights[..., None] * self.post[:, None]  # [S,2,U]
        return slope, threshold, sums.flatten(1)


def inverse_softplus(y: Tensor) -> Tensor:
    """Return x with softplus(x) = y, for y > 0."""
    return y + (-(-y).expm1()).log()
