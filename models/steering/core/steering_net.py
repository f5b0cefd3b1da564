"""The network of the paper's figure: a spatial network on each frame, a recurrent one over the frames.

A network is a file. `spatial: mean` in params.yaml is models/steering/spatial/mean.py, listed nowhere else:

    class Mean(nn.Module):                      # batch of B frames (core/batch.py) → features [B,F]
        def __init__(self, features: int, scale_m: float) -> None: ...

    class Options(NetworkOptions):              # the options that an entry of `models` may set
        kind: ClassVar[FrameKind] = "graph"     # its input: "graph" | "pointnet2" | "image"; spatial networks only
        scale_m: Annotated[float, Field(gt=0)] = 10.0

        def build(self, sizes: Sizes) -> nn.Module:
            return Mean(sizes.features, self.scale_m)

A temporal file is the same with a RecurrentCell (core/recurrent.py). A cell of `temporal: ncp` is a file of core/cell/
and a line of temporal/ncp.py. DVC retrains a model when core or one of its two files changes, so a network's file may
import only core and pipeline.camera.classes; tests/test_dvc_yaml.py checks it.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.batch import Array, Batch, from_arrays
from models.steering.core.options import NetworkOptions, Sizes
from models.steering.core.recurrent import RecurrentCell

HIDDEN = 16  # neurons of the network for log σ
MOTION_MIRROR_SIGNS = (-1.0, -1.0, 1.0, 1.0)
"""Factor of each column of `motion` under left-right mirroring.

The columns are the measured angle (rad) and yaw rate (rad/s), both left +, speed (m/s) and valid (0 or 1).
"""
# Scales: a sharp corner for the columns that change sign, a fast street for the others.
ODD_SCALE, EVEN_SCALE = (0.25, 0.4), (15.0, 1.0)  # rad, rad/s; m/s, 1


class SteeringNet(nn.Module):
    """Predict steering from windows of frames. Letters: B frames, W windows of T frames, F features.

    Args:
        equivariant: make the output exactly odd under left-right mirroring, as steering is in the bicycle model. The
            features are those of the frame minus those of its mirror image, and the output is (f(x) - f(-x)) / 2 of the
            recurrent network. The paper has no such symmetry.
        motion: the recurrent network also gets the measured motion, and its output is the residual to the measured
            angle, in units of its standard deviation. The paper has no such input.
        uncertainty: network from the recurrent network's state [W,U] to log σ [W,1] or [W,R], the logarithm of the
            error's standard deviation. Its gradient ends at the state: it does not change what the mean is learned
            from.
        path: predict the path ahead, R numbers per window, and not an angle.
    """

    def __init__(
        self,
        spatial: nn.Module,
        temporal: RecurrentCell,
        equivariant: bool = False,
        motion: bool = False,
        uncertainty: nn.Module | None = None,
        path: bool = False,
    ) -> None:
        super().__init__()
        self.spatial = spatial
        self.temporal = temporal
        self.equivariant = equivariant
        self.motion = motion
        self.uncertainty = uncertainty
        self.features: tuple[str, int] | None = None
        """File of the spatial network and its number of features per frame, if known, for the error message."""
        self.path = path

    def forward(
        self, batch: Batch, windows: Tensor, dt_s: Tensor, motion: Tensor | None = None, pairs: bool = False
    ) -> Tensor:
        """Predict the standardised steering, or residual, at each window's last frame.

        Windows may overlap: each frame is encoded once.

        Args:
            batch: B frames.
            windows: int64 [W,T], the frames of each window, oldest first.
            dt_s: [W,T] seconds since the previous frame.
            motion: [B,4], see MOTION_MIRROR_SIGNS; required with motion.
            pairs: predict for the windows and for their mirror images.
        Returns:
            [W], of a path [W,R]; with uncertainty [W,2] or [W,2R], the second half is log σ. With pairs the mirror
            images follow.
        """
        if not (self.equivariant or pairs):
            return self.span_windows(self.spatial(batch), windows, dt_s, motion)
        both: Any = getattr(self.spatial, "both", None)  # of networks that share a part of the two
        original, mirrored = both(batch) if both else (self.spatial(batch), self.spatial(batch.mirrored()))
        if self.equivariant:
            out = self.span_windows(original - mirrored, windows, dt_s, motion)
            return torch.cat([out, self._mirror(out)]) if pairs else out
        windows = torch.cat([windows, windows + len(original)])
        if motion is not None:
            motion = torch.cat([motion, torch.cat([-motion[:, :2], motion[:, 2:]], dim=1)])
        return self.span_windows(torch.cat([original, mirrored]), windows, dt_s.repeat(2, 1), motion)

    def span_windows(self, features: Tensor, windows: Tensor, dt_s: Tensor, motion: Tensor | None = None) -> Tensor:
        """Predict as `forward`, from the features [B,F] of encoded frames. Raises ValueError for another F."""
        if self.features and features.shape[1:] != self.features[1:]:
            file, expected = self.features
            problem = f"the spatial network returns {list(features.shape)} for {len(features)} frames"
            raise ValueError(f"{file}: {problem}, expected [{len(features)}, {expected}] (sizes.features)")
        with torch.autocast(features.device.type, enabled=False):  # a small part of the work, and an ODE
            odd = features.to(next(self.temporal.parameters()).dtype)  # mirror-odd inputs, and even ones [B,..]
            even = odd.new_empty(len(odd), 0)
            if self.motion:
                assert motion is not None, "a network with motion needs the motion of each frame"
                odd_motion, even = odd_and_even(motion.to(odd))
                odd = torch.cat([odd, odd_motion], dim=1)
            inputs = torch.cat([odd, even], dim=1)
            if self.equivariant:
                inputs = torch.cat([inputs, torch.cat([-odd, even], dim=1)])
                windows, dt_s = torch.cat([windows, windows + len(odd)]), dt_s.repeat(2, 1)
            projected = self.temporal.project_inputs(inputs)  # [B,S]
            states, state = self.temporal(projected[windows], dt_s.to(projected))  # [W,T,R]
            out: Tensor = states[:, -1] if self.path or self.uncertainty is not None else states[:, -1, 0]
            if self.uncertainty is not None:
                out = torch.cat([out, self.uncertainty(torch.cat(state, dim=1).detach())], dim=1)
            if not self.equivariant:
                return out
            original, mirrored = out.chunk(2)
            return (original + self._mirror(mirrored)) / 2

    def _mirror(self, output: Tensor) -> Tensor:
        """Return the output for the mirrored scene: steering changes its sign, its σ does not."""
        if self.uncertainty is None:
            return -output
        mean, log_sigma = output.chunk(2, dim=1)
        return torch.cat([-mean, log_sigma], dim=1)

    def inputs(self, arrays: Mapping[str, Array]) -> tuple[Batch, Tensor, Tensor, Tensor | None]:
        """Return the arguments of `forward` on the network's device, from arrays by name (pipeline/train/windows.py).

        Names: those of the frames, `windows` [W,T], `dt_s` [W,T], and with motion `motion` [B,4].
        """
        device = next(self.parameters()).device
        tensors = {name: torch.as_tensor(arrays[name]) for name in ("windows", "dt_s", "motion") if name in arrays}
        moved = {name: tensor.to(device, non_blocking=True) for name, tensor in tensors.items()}
        return from_arrays(arrays, device), moved["windows"], moved["dt_s"], moved.get("motion")

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.parameters()).device


def odd_and_even(motion: Tensor) -> tuple[Tensor, Tensor]:
    """Split motion [B,4] into the columns that change sign in the mirror and the others, each [B,2] and O(1).

    Odd columns saturate at ±1: a value far beyond a sharp corner is a measurement error.
    """
    # Numbers as scalars: a tensor made of them would be a blocking copy to a GPU in each step.
    scaled = [column / scale for column, scale in zip(motion.unbind(1), ODD_SCALE + EVEN_SCALE, strict=True)]
    return torch.tanh(torch.stack(scaled[:2], dim=1)), torch.stack(scaled[2:], dim=1)


def build(
    spatial: NetworkOptions,
    temporal: NetworkOptions,
    sizes: Sizes,
    *,
    equivariant: bool = False,
    motion: bool = False,
    uncertainty: bool = False,
    path: bool = False,
) -> SteeringNet:
    """Build the network with new weights from torch's random state. Raises ValueError if an option is out of range."""
    # Random numbers are drawn in this order: a seed's weights depend on it.
    spatial_net = spatial.build(sizes)
    inputs = sizes.features + motion * len(MOTION_MIRROR_SIGNS)
    temporal_net: Any = temporal.build(replace(sizes, features=inputs))
    sigma_net = None
    if uncertainty:
        units = temporal_net.state_size(inputs)
        sigma_net = nn.Sequential(nn.Linear(units, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, sizes.outputs))
    net = SteeringNet(spatial_net, temporal_net, equivariant, motion, sigma_net, path)
    net.features = f"{type(spatial).__module__.replace('.', '/')}.py", sizes.features
    return net


def parameter_count(model: nn.Module) -> int:
    """Return the number of trainable parameters."""
    return sum(parameter.numel() for parameter in model.parameters() if parameter.requires_grad)
