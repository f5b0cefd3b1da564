"""Run a new network on small frames, and find the rules of its contract that it breaks.

A network that breaks a rule often trains, and its errors look like results. The rules of a spatial
network are those of models/steering/core/steering_net.py: a frame's features depend on the frame
alone, and not on the order of its points. BatchNorm, dropout, frozen parts and bfloat16 are
allowed.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core.batch import Batch, from_arrays
from models.steering.core.motion import SCALES
from models.steering.core.recurrent import NOMINAL_STEP_S
from models.steering.core.steering_net import SteeringNet
from pipeline.base.errors import InputError, error_context
from pipeline.check.street_frames import join_frames, make_frames, shuffle_points
from pipeline.graphs.graph_file import Columns
from pipeline.graphs.settings import Variant
from pipeline.train.entry import Entry

# Largest number of points of a frame.
POINTS = 1000
# Number of windows on which a temporal network runs.
WINDOWS = 5
# Share of the spread between items above which two outputs differ. bfloat16 rounds to 0.4 %.
TOLERANCE = 0.01
# Share of the largest output above which two outputs differ, if all items have equal ones.
ROUNDING = 1e-4
# Seed of weights that are drawn in a call, of frames and of windows.
SEED = 0
# Function that returns the outputs of a network for some frames or windows, by their numbers.
Run = Callable[[Sequence[int]], Tensor]


def check_network(
    net: SteeringNet, entry: Entry, variant: Variant, image_size: tuple[int, int], outputs: int
) -> None:
    """Run a network with new weights. Raises InputError for the first rule that it breaks.

    `variant` and `image_size` (H,W) describe the frames, and `outputs` is the number of columns of
    the predicted quantity. torch's random state stays as it was. An exception of the network itself
    is raised as it is.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(SEED)
        with error_context(f"spatial: {entry.spatial}"):
            _check_spatial(net, entry, variant, image_size)
        with error_context(f"temporal: {entry.temporal}"):
            _check_temporal(net, entry, outputs)


def _check_spatial(
    net: SteeringNet, entry: Entry, variant: Variant, image_size: tuple[int, int]
) -> None:
    """Check the features of frames with many points, half as many, and none."""
    points = min(variant.points or 0, POINTS)
    counts = [points, points, points // 2, 0]
    frames = make_frames(variant, counts, image_size, seed=SEED)

    def join_batch(members: Sequence[Columns]) -> Batch:
        return from_arrays(join_frames(members, entry.network))

    def run_frames(numbers: Sequence[int]) -> Tensor:
        output: Tensor = net.spatial(join_batch([frames[row] for row in numbers]))
        return output

    # The last frame, without points, comes only together with others.
    occupied = len(counts) - 1
    together = _check_prediction(
        net.spatial,
        run_frames,
        count=len(counts),
        lone=occupied,
        shape=[entry.features],
        item="frame",
    )
    with torch.no_grad():
        if variant.kind == "graph":
            rng = np.random.default_rng(SEED)
            shuffled = join_batch([shuffle_points(frame, rng) for frame in frames[:occupied]])
            problem = "the features depend on the order of the points"
            fix = "Pool by a sum, a mean or a maximum"
            _check_equal(net.spatial(shuffled), together[:occupied], problem, fix)
        if net.equivariant:
            # An equivariant network subtracts the features of the mirror image from those of the
            # frame. Both have one copy of the input there, and two here.
            mirrored = net.spatial(join_batch(frames).mirrored())
            from_one_copy = net._features(join_batch(frames))[: len(frames)]
            problem = "changes its input, from which equivariant: true makes the mirror image"
            _check_equal(from_one_copy, together - mirrored, problem, "Copy what it changes")
    _check_training(net.spatial, run_frames, count=len(counts), shape=[entry.features])


def _check_temporal(net: SteeringNet, entry: Entry, outputs: int) -> None:
    """Check the outputs for windows of random features.

    Only the last output of a window is read, so it may depend on all frames of the window.
    """
    inputs = entry.features
    if net.motion:
        inputs += len(SCALES)
    frames = 2 * entry.window
    features = torch.rand(frames, inputs) * 2 - 1
    first = torch.randint(0, frames - entry.window + 1, (WINDOWS, 1))
    windows = first + torch.arange(entry.window)
    dt_s = NOMINAL_STEP_S * (0.5 + torch.rand(windows.shape))

    def run_windows(numbers: Sequence[int]) -> Tensor:
        # Frames are projected once for all windows that contain them, as in SteeringNet.
        used, rows = torch.unique(windows[list(numbers)], return_inverse=True)
        projected = net.temporal.project_inputs(features[used])
        output: Tensor = net.temporal(projected[rows], dt_s[list(numbers)])
        return output

    shape = [entry.window, outputs]
    _check_prediction(
        net.temporal, run_windows, count=WINDOWS, lone=WINDOWS, shape=shape, item="window"
    )
    _check_training(net.temporal, run_windows, count=WINDOWS, shape=shape)


def _check_prediction(
    network: nn.Module, run: Run, count: int, lone: int, shape: Sequence[int], item: str
) -> Tensor:
    """Check the outputs for each item alone, for a batch of items, and for the same batch again.

    `run` returns outputs, each of `shape`, for some of `count` items by their numbers. The first
    `lone` of them are also run alone. An `item` is a frame or a window. Returns the outputs for all
    items.
    """
    # A training copies the weights and gives them to the optimiser before the first batch.
    for name, tensor in (*network.named_parameters(), *network.named_buffers()):
        if nn.parameter.is_lazy(tensor):
            problem = f"{name} has no size before the first batch"
            raise InputError(problem, fix="Use a layer with sizes, such as Linear for LazyLinear")

    network.eval()
    with torch.no_grad():
        # Items alone come first. If the batch left a state in the network, they would differ.
        alone = [run([number]) for number in range(lone)]
        for output in alone:
            _check_output(output, [1, *shape], "in prediction")
        together = run(range(count))
        _check_output(together, [count, *shape], "in prediction")
        problem = f"returns other values for the same {item}s when it is called again"
        fix = "Keep no state between calls, and draw no random numbers in prediction"
        _check_equal(run(range(count)), together, problem, fix)

        problem = f"what it returns for a {item} depends on the other {item}s of its batch"
        fix = f"Compute it from the {item} alone, without a state of earlier calls"
        for output in (torch.cat(alone), run(range(lone))):
            _check_equal(output, together[:lone], problem, fix)
    return together


def _check_training(network: nn.Module, run: Run, count: int, shape: Sequence[int]) -> None:
    """Check the outputs for a batch of `count` items in training, and that weights get a gradient.

    It comes after the prediction, since outputs may depend on a state that training leaves.
    """
    network.train()
    output = run(range(count))
    _check_output(output, [count, *shape], "in training")
    weights = [weight for weight in network.parameters() if weight.requires_grad]
    if not weights:
        return
    if output.requires_grad:
        output.square().sum().backward()  # type: ignore[no-untyped-call]
    if all(weight.grad is None for weight in weights):
        fix = "Look for detach, no_grad or numpy between the weights and the output"
        raise InputError("no weight gets a gradient", fix=fix)


def _check_output(output: Tensor, shape: Sequence[int], mode: str) -> None:
    """Raise InputError unless an output is a float32 tensor of a shape, and finite."""
    if not isinstance(output, Tensor):
        raise InputError(f"returns {type(output).__name__}, expected a tensor {list(shape)}")
    if list(output.shape) != list(shape):
        raise InputError(f"returns the shape {list(output.shape)} {mode}, expected {list(shape)}")
    if output.dtype != torch.float32:
        raise InputError(f"returns {output.dtype} {mode}, expected torch.float32")
    _check_finite(output, mode)


def _check_finite(output: Tensor, mode: str) -> None:
    if not output.isfinite().all():
        fix = "Look for a division by 0 or an overflow; a frame may have no points"
        raise InputError(f"returns NaN or infinity {mode}", fix=fix)


def _check_equal(output: Tensor, expected: Tensor, problem: str, fix: str) -> None:
    """Raise InputError if outputs in prediction differ from the expected ones, both [B, ...]."""
    _check_finite(output, "in prediction")
    spread = (expected - expected.mean(0)).square().mean().sqrt()
    limit = torch.maximum(TOLERANCE * spread, ROUNDING * expected.abs().max())
    if (output - expected).abs().max() > limit:
        raise InputError(problem, fix=fix)
