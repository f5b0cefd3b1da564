"""The network: a spatial network on each frame, a recurrent one over the frames of a window.

A network is a file, and is listed nowhere else: `spatial: mean` in params.yaml stands for
models/steering/spatial/mean.py. The file has two classes. The first is an nn.Module from a batch of
B frames (core/batch.py) to features [B,F]. A frame's features must not depend on the order of its
points, nor on other frames. The second is Options(NetworkOptions) with a field for each option, the
`kind` of frames that the network reads, and a method `build`. A temporal file has a RecurrentCell
(core/recurrent.py), and its Options have no `kind`. docs/models.md has an example.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.batch import Array, Batch, from_arrays
from models.steering.core.motion import SCALES, mirrored_motion, scaled_motion
from models.steering.core.options import NetworkOptions, Sizes

# Added to variances, so that a constant feature becomes 0.
EPSILON = 1e-6


class FeatureScale(nn.Module):
    """Standardise each feature over frames, then apply tanh.

    The features that a spatial network pools over a frame are nearly the same in every frame of a
    street. A tanh would saturate on this common part, the difference between frames would be lost,
    and training would stay on a plateau. So the mean is subtracted, and the result divided by the
    standard deviation. In training, mean and deviation are those of the batch's frames. In
    prediction they are running values: plain means over the first training steps, later moving
    averages with `momentum`. Nothing is learned. If not `centred`, features are only divided, so
    odd features stay odd. The tanh is applied because LTC synapses are sensitive in (-1, 1).
    """

    mean: Tensor
    variance: Tensor
    steps: Tensor

    def __init__(self, features: int, *, centred: bool, momentum: float = 0.02) -> None:
        super().__init__()
        self.centred = centred
        self.momentum = momentum
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("variance", torch.ones(features))
        self.register_buffer("steps", torch.tensor(0))

    def forward(self, x: Tensor) -> Tensor:
        """Standardise the features of B frames: [B,F] → [B,F] in (-1, 1)."""
        mean = self.mean
        variance = self.variance
        if self.training:
            if self.centred:
                mean = x.mean(0)
            variance = (x - mean).square().mean(0)
            with torch.no_grad():
                self.steps += 1
                weight = (1 / self.steps.to(x.dtype)).clamp_min(self.momentum)
                self.mean.lerp_(mean, weight)
                self.variance.lerp_(variance, weight)
        return torch.tanh((x - mean) * (variance + EPSILON).rsqrt())


class SteeringNet(nn.Module):
    """Predict steering from windows of frames.

    Letters: B frames, W windows of T frames, F features, R outputs.

    Args:
        spatial, temporal: options of the two networks. New weights are drawn from torch's random
            state.
        equivariant: make the output exactly odd under left-right mirroring, as steering is in the
            bicycle model. The features of the mirror image are subtracted from those of the frame.
            The output is (f(x) - f(-x)) / 2, where f is the recurrent network and x its inputs. The
            paper has no such symmetry.
        motion: give the measured motion to the recurrent network, too. Its output is then the
            difference to the measured angle, in units of that difference's standard deviation. The
            paper has no such input.
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
        self.equivariant = equivariant
        self.motion = motion
        self.sees_frames = spatial.sees_frames
        # The order of these lines must stay: the weights of a seed depend on the order in which
        # random numbers are drawn.
        self.spatial: Any = spatial.build(sizes)
        self.scale = FeatureScale(sizes.features, centred=not equivariant)
        inputs = sizes.features
        if motion:
            inputs += len(SCALES)
        self.temporal: Any = temporal.build(replace(sizes, features=inputs))

    def forward(
        self,
        batch: Batch,
        windows: Tensor,
        dt_s: Tensor,
        motion: Tensor | None = None,
    ) -> Tensor:
        """Predict the standardised steering, or residual, of each window's last frame, [W,R].

        Each frame is encoded once for all windows that contain it.

        Args:
            batch: B frames.
            windows: int64 [W,T], the numbers of each window's frames, oldest first.
            dt_s: [W,T], seconds since the previous frame.
            motion: [B,4], see core/motion.py; required if the network has motion.
        """
        inputs = self.scale(self._features(batch))

        # From here on, mirror images are additional frames and additional windows.
        if self.equivariant:
            windows = torch.cat([windows, windows + len(inputs) // 2])
            dt_s = dt_s.repeat(2, 1)

        if self.motion:
            assert motion is not None, "a network with motion needs the motion of each frame"
            if self.equivariant:
                motion = torch.cat([motion, mirrored_motion(motion)])
            inputs = torch.cat([inputs, scaled_motion(motion.to(inputs))], dim=1)

        projected = self.temporal.project_inputs(inputs)  # once for each frame
        out: Tensor = self.temporal(projected[windows], dt_s.to(projected))[:, -1]  # [W,R]
        if self.equivariant:
            original, mirrored = out.chunk(2)
            out = (original - mirrored) / 2
        return out

    def _features(self, batch: Batch) -> Tensor:
        """Return the features of the frames, [B,F].

        If equivariant, the features of their mirror images follow, [2B,F] in total. A spatial
        network may have a method `with_mirrored` that computes both faster.
        """
        if not self.equivariant:
            features: Tensor = self.spatial(batch)
            return features
        if hasattr(self.spatial, "with_mirrored"):
            original, mirrored = self.spatial.with_mirrored(batch)
        else:
            original = self.spatial(batch)
            mirrored = self.spatial(batch.mirrored())
        return torch.cat([original - mirrored, mirrored - original])

    def inputs(self, arrays: Mapping[str, Array]) -> tuple[Batch, Tensor, Tensor, Tensor | None]:
        """Return the arguments of `forward`, on the network's device.

        `arrays` is a batch as pipeline/train/windows.py describes it.
        """
        tensors = {}
        for name in ("windows", "dt_s", "motion"):
            if name in arrays:
                tensor = torch.as_tensor(arrays[name])
                tensors[name] = tensor.to(self.device, non_blocking=True)
        return (
            from_arrays(arrays, self.device),
            tensors["windows"],
            tensors["dt_s"],
            tensors.get("motion"),
        )

    @property
    def device(self) -> torch.device:
        return self.scale.mean.device
