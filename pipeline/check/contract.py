"""Run a new network on small frames, and find the rules of its contract that it breaks.

A network that breaks a rule often trains, and its errors look like results. The rules of a spatial
network are those of models/steering/core/steering_net.py: a frame's features depend on the frame
alone, and not on the order of its points. BatchNorm, dropout, frozen parts and bfloat16 are right.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core.batch import Batch, from_arrays
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.steering_net import SteeringNet
from pipeline.base.errors import InputError, error_context
from pipeline.check.street_frames import join_frames, make_frames, shuffle_points
from pipeline.graphs.graph_file import Columns
from pipeline.graphs.settings import Variant
from pipeline.train.entry import Entry

# Largest number of points of a frame.
POINTS = 1000
# Share of the spread between frames above which two features differ. bfloat16 rounds to 0.4 %.
TOLERANCE = 0.01
# Share of the largest feature above which two features differ, if all frames have equal ones.
ROUNDING = 1e-4
# Number of windows on which a temporal network runs.
WINDOWS = 5
SEED = 0


def check_network(
    net: SteeringNet, entry: Entry, variant: Variant, image_size: tuple[int, int], outputs: int
) -> None:
    """Run a network with new weights. Raises InputError for the first rule that it breaks.

    `variant` and `image_size` (H,W) describe the frames, and `outputs` is the number of columns of
    the predicted quantity. torch's random state stays as it was. An exception of the network itself
    is raised as it is.
    """
    # A compiled network runs without compilation, which would take a minute. Without one, the
    # compiler has not been imported, and importing it would take seconds.
    eager: AbstractContextManager[None] = nullcontext()
    if "torch._dynamo" in sys.modules:
        eager = torch.compiler.set_stance("force_eager")
    with torch.random.fork_rng(devices=[]), eager:
        torch.manual_seed(SEED)
        with error_context(f"spatial: {entry.spatial}"):
            _check_parameters(net.spatial)
            _check_spatial(net, entry.features, variant, image_size)
        with error_context(f"temporal: {entry.temporal}"):
            _check_parameters(net.temporal)
            _check_temporal(net, entry, outputs)


def _check_parameters(net: nn.Module) -> None:
    for name, parameter in net.named_parameters():
        if nn.parameter.is_lazy(parameter):
            problem = f"parameter {name} has no size before the first batch"
            raise InputError(problem, fix="Use a layer with sizes, such as Linear for LazyLinear")


def _check_spatial(
    net: SteeringNet, features: int, variant: Variant, image_size: tuple[int, int]
) -> None:
    """Check the features of frames with many points, half as many, and none."""
    points = min(variant.points or 0, POINTS)
    counts = [points, points, points // 2, 0]
    frames = make_frames(variant, counts, image_size, SEED)

    def run(some: Sequence[Columns]) -> Tensor:
        """Return the features of frames, which are copied, as a network may change its input."""
        return _run(net.spatial, from_arrays(join_frames(some)))

    net.train()
    shape = [len(frames), features]
    output = run(frames)
    if len(output) == sum(counts) and len(output) != len(frames):
        problem = f"returns a row for each point, {list(output.shape)}, expected {shape}"
        raise InputError(problem, fix="Pool the points of each frame, for instance mean_max_pool")
    _check_output(output, shape, "in training", counts)
    _check_gradient(net.spatial, output)

    net.eval()
    with torch.no_grad():
        together = run(frames)
        _check_output(together, shape, "in prediction", counts)
        _check_equal(
            run(frames),
            together,
            "returns other features for the same frames when it is called again",
            "It must keep no state between calls, and draw no random numbers in prediction",
        )
        # The frames with points in a batch without the empty one, and each in a batch of its own.
        full_frames = frames[:-1]
        full = run(full_frames)
        _check_output(full, [len(full_frames), features], "in prediction", counts)
        alone = torch.cat([run([frame]) for frame in full_frames])
        for output in (full, alone):
            _check_equal(
                output,
                together[:-1],
                "the features of a frame depend on the other frames of its batch",
                "Compute them from the rows ptr[b]:ptr[b+1] of the frame alone",
            )
        if variant.kind == "graph":
            rng = np.random.default_rng(SEED)
            shuffled = [shuffle_points(frame, rng) for frame in full_frames]
            _check_equal(
                run(shuffled),
                together[:-1],
                "the features depend on the order of the points",
                "Pool by a sum, a mean or a maximum",
            )
        if net.equivariant:
            batch = from_arrays(join_frames(frames))
            mirrored = from_arrays(join_frames(frames)).mirrored()
            difference = together - _run(net.spatial, mirrored)
            _check_equal(
                net._features(batch)[: len(frames)],
                difference,
                "changes its input, from which the mirror image of equivariant: true is made",
                "Copy what it changes",
            )


def _check_temporal(net: SteeringNet, entry: Entry, outputs: int) -> None:
    """Check the outputs of windows of random features."""
    frames = 2 * entry.window
    inputs = entry.features
    if net.motion:
        inputs += 4
    features = torch.rand(frames, inputs) * 2 - 1
    first = torch.randint(0, frames - entry.window + 1, (WINDOWS, 1))
    windows = first + torch.arange(entry.window)
    dt_s = torch.full(windows.shape, NOMINAL_STEP_S)

    def run(rows: slice) -> Tensor:
        projected = net.temporal.project_inputs(features.clone())
        return net.temporal(projected[windows[rows]], dt_s[rows].clone())

    net.train()
    shape = [WINDOWS, entry.window, outputs]
    every = slice(0, WINDOWS)
    output = run(every)
    _check_output(output, shape, "in training")
    _check_gradient(net.temporal, output)

    net.eval()
    with torch.no_grad():
        together = run(every)
        _check_output(together, shape, "in prediction")
        _check_equal(
            run(every)[:, -1],
            together[:, -1],
            "returns other outputs for the same windows when it is called again",
            "It must keep no state between calls, and draw no random numbers in prediction",
        )
        alone = torch.cat([run(slice(row, row + 1)) for row in range(WINDOWS)])
        _check_equal(
            alone[:, -1],
            together[:, -1],
            "the output of a window depends on the other windows of its batch",
            "Start each window from the same state",
        )


def _run(network: Callable[[Batch], Tensor], batch: Batch) -> Tensor:
    return network(batch)


def _check_output(
    output: Tensor, shape: Sequence[int], mode: str, counts: Sequence[int] = ()
) -> None:
    """Raise InputError unless an output is float32 of a shape, and finite."""
    if list(output.shape) != list(shape):
        raise InputError(f"returns the shape {list(output.shape)} {mode}, expected {list(shape)}")
    if output.dtype != torch.float32:
        raise InputError(f"returns {output.dtype} {mode}, expected torch.float32")
    broken = (~output.isfinite()).flatten(1).any(dim=1).nonzero().flatten().tolist()
    if broken:
        problem = f"returns NaN or infinity {mode}"
        if counts:
            problem += f" for a frame with {counts[broken[-1]]} points"
        raise InputError(problem, fix="Look for a division by 0 or an overflow")


def _check_gradient(net: nn.Module, output: Tensor) -> None:
    """Raise InputError if no weight gets a gradient, though one asks for it."""
    weights = [weight for weight in net.parameters() if weight.requires_grad]
    if not weights:
        return
    if output.requires_grad:
        output.square().sum().backward()  # type: ignore[no-untyped-call]
    if all(weight.grad is None for weight in weights):
        fix = "Look for detach, no_grad or numpy between the weights and the output"
        raise InputError("no weight gets a gradient", fix=fix)
    net.zero_grad()


def _check_equal(output: Tensor, expected: Tensor, problem: str, fix: str) -> None:
    """Raise InputError if an output differs from the expected one [B, ...]."""
    spread = (expected - expected.mean(0)).square().mean().sqrt()
    limit = torch.maximum(TOLERANCE * spread, ROUNDING * expected.abs().max())
    if (output - expected).abs().max() > limit:
        raise InputError(problem, fix=fix)
