"""The network: a spatial network on each frame, a recurrent one over the frames of a window.

A network is a file, listed nowhere else: `spatial: mean` in params.yaml is
models/steering/spatial/mean.py. It has an nn.Module from a batch of B frames (core/batch.py) to
features [B,F], independent of the order of points and of other frames, and a class
Options(NetworkOptions) with a field per option, `kind`, the frames that it reads, and `build`. A
temporal file has a RecurrentCell (core/recurrent.py), and options without `kind`. docs/models.md
has an example.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.batch import Array, Batch, from_arrays
from models.steering.core.options import NetworkOptions, Sizes

MOTION_SCALES = (0.25, 0.4, 15.0, 1.0)  # a sharp corner, a fast street
"""Scales of the columns of `motion`: angle (rad) and yaw rate (rad/s), both left +, speed (m/s) and
valid (0 or 1).
"""
EPSILON = 1e-6  # added to variances


class FeatureScale(nn.Module):
    """Standardise each feature over frames, then apply tanh, since LTC synapses are sensitive in
    (-1, 1).

    What a spatial network pools over a frame is nearly the same in every frame of a street. A tanh
    saturates on this common part, the difference between frames is lost, and training stays on a
    plateau. So in training the mean and variance of the batch's frames are removed, in prediction
    running ones: means over the first steps, later moving averages with `momentum`. Nothing is
    learned. Without `centred` features are only divided, which keeps them odd.
    """

    mean: Tensor
    variance: Tensor
    steps: Tensor

    def __init__(self, features: int, *, centred: bool, momentum: float = 0.02) -> None:
        super().__init__()
        self.centred, self.momentum = centred, momentum
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("variance", torch.ones(features))
        self.register_buffer("steps", torch.tensor(0))

    def forward(self, x: Tensor) -> Tensor:
        """Standardise the features of B frames: [B,F] → [B,F] in (-1, 1)."""
        mean, variance = self.mean, self.variance
        if self.training:
            mean = x.mean(0) if self.centred else mean
            variance = (x - mean).square().mean(0)
            with torch.no_grad():
                self.steps += 1
                weight = (1 / self.steps.to(x.dtype)).clamp_min(self.momentum)
                self.mean.lerp_(mean, weight)
                self.variance.lerp_(variance, weight)
        return torch.tanh((x - mean) * (variance + EPSILON).rsqrt())


class SteeringNet(nn.Module):
    """Predict steering from windows of frames. Letters: B frames, W windows of T frames, F
    features, R outputs.

    Args:
        spatial, temporal: options of the two networks. New weights are drawn from torch's random
            state.
        equivariant: make the output exactly odd under left-right mirroring, as steering is in the
            bicycle model. The features are those of the frame minus those of its mirror image, and
            the output is (f(x) - f(-x)) / 2 of the recurrent network. The paper has no such
            symmetry.
        motion: the recurrent network also gets the measured motion, and its output is the residual
            to the measured angle, in units of its standard deviation. The paper has no such input.
    Raises InputError if an option is out of range.
    """

    def __init__(
        self,
        spatial: NetworkOptions,
        temporal: NetworkOptions,
        sizes: Sizes,
        *,
        equivariant: bool = False,
        motion: bool = False,
    ) -> None:
        super().__init__()
        self.equivariant, self.motion, self.sees = equivariant, motion, spatial.sees
        # Random numbers are drawn in this order: a seed's weights depend on it.
        self.spatial = spatial.build(sizes)
        self.scale = FeatureScale(sizes.features, centred=not equivariant)
        inputs = sizes.features + motion * len(MOTION_SCALES)
        self.temporal: Any = temporal.build(replace(sizes, features=inputs))

    def forward(
        self,
        batch: Batch,
        windows: Tensor,
        dt_s: Tensor,
        motion: Tensor | None = None,
        scenes: Tensor | None = None,
    ) -> Tensor:
        """Predict the standardised steering, or residual, [W,R] of each window's last frame; a
        frame is encoded once.

        Args:
            batch: B frames, or the frames that `scenes` counts.
            windows: int64 [W,T], the frames of each window, oldest first.
            dt_s: [W,T] seconds since the previous frame.
            motion: [B,4], see MOTION_SCALES; required with motion.
            scenes: of a control, int64 [B], the frame of the batch that each of B frames sees;
                None: its own.
        """
        if self.equivariant:  # the frames, then their mirror images
            # of networks that share a part of the two
            both: Any = getattr(self.spatial, "both", None)
            original, mirrored = (
                both(batch) if both else (self.spatial(batch), self.spatial(batch.mirrored()))
            )
            features = torch.cat([original - mirrored, mirrored - original])
        else:
            features = self.spatial(batch)
        inputs = self.scale(features)
        if scenes is not None:
            inputs = torch.cat([version[scenes] for version in inputs.chunk(1 + self.equivariant)])
        if self.equivariant:
            windows, dt_s = torch.cat([windows, windows + len(inputs) // 2]), dt_s.repeat(2, 1)
            if motion is not None:
                motion = torch.cat([motion, torch.cat([-motion[:, :2], motion[:, 2:]], dim=1)])
        if self.motion:
            assert motion is not None, "a network with motion needs the motion of each frame"
            inputs = torch.cat([inputs, scaled(motion.to(inputs))], dim=1)
        projected = self.temporal.project_inputs(inputs)  # once for each frame
        out: Tensor = self.temporal(projected[windows], dt_s.to(projected))[:, -1]  # [W,R]
        if self.equivariant:
            original, mirrored = out.chunk(2)
            out = (original - mirrored) / 2
        return out

    def inputs(
        self, arrays: Mapping[str, Array]
    ) -> tuple[Batch, Tensor, Tensor, Tensor | None, Tensor | None]:
        """Return the arguments of `forward`, on the network's device, from the arrays of
        pipeline/train/windows.py.
        """
        device, names = (
            self.device,
            [name for name in ("windows", "dt_s", "motion", "scenes") if name in arrays],
        )
        there = {
            name: torch.as_tensor(arrays[name]).to(device, non_blocking=True) for name in names
        }
        return (
            from_arrays(arrays, device),
            there["windows"],
            there["dt_s"],
            there.get("motion"),
            there.get("scenes"),
        )

    @property
    def device(self) -> torch.device:
        return self.scale.mean.device


def scaled(motion: Tensor) -> Tensor:
    """Return motion [B,4] with columns of O(1). A turn far beyond a sharp corner is a measurement
    error: ±1 at most.
    """
    # Scales as numbers: a tensor made of them would be a blocking copy to a GPU in each step.
    columns = [
        column / scale for column, scale in zip(motion.unbind(1), MOTION_SCALES, strict=True)
    ]
    return torch.cat(
        [torch.tanh(torch.stack(columns[:2], dim=1)), torch.stack(columns[2:], dim=1)], dim=1
    )
