"""The paper's figure: a spatial network on each frame, a recurrent one over the frames.

A network is a file: `spatial: mean` in params.yaml is models/steering/spatial/mean.py, and nothing else names it:

    INPUT: Kind = "graph"                  # what it expects: "graph" | "pointnet2" | "image"; spatial networks only

    class Mean(nn.Module):                 # GraphBatch | SetBatch | ImageBatch of B frames → [B, features]
        def __init__(self, features: int, *, scale_m: Annotated[float, Field(gt=0)] = 10.0) -> None: ...

    network = Mean                         # a class, or a function that returns an nn.Module

By position it takes what is known of its data, by name: `features` (numbers per frame between the two networks),
`window` (frames), `levels` (pointnet2), `image_size` (image; H, W). Behind the * stand its knobs: keys of the model's
line, with their types and defaults. A temporal file's network is a RecurrentCell (see recurrent.py). `cell: NAME` of
temporal ncp is core/cell/NAME.py, whose `cell(wiring)` returns a RecurrentCell.
DVC trains a model again when core or one of its two files changes; so a file may import only these and
pipeline.camera.classes, which stage check sees to: what two networks share lies in core.
"""

from collections.abc import Mapping
from typing import Any, get_args

import torch
from torch import Tensor, nn

from models.steering.core.batch import Array, Batch, Kind, of_arrays
from models.steering.core.knobs import meant, plain, written
from models.steering.core.motion import COLUMNS, odd_and_even
from models.steering.core.network_file import Network, Part, load
from models.steering.core.recurrent import RecurrentCell, State
from models.steering.core.wiring import Sizes, Wiring, ncp

Line = Mapping[str, Any]  # a model's line of params.yaml

# The keys of a line that are no network's; pipeline/sections/models.py has their types.
GENERAL = (
    "input", "spatial", "temporal", "window", "equivariant", "learning_rate", "alpha", "features", "horizon", "motion",
    "fit_to", "roads",
)  # fmt: skip
KINDS: dict[Kind, str] = {
    "graph": "kNN graphs",
    "pointnet2": "points with neighbourhood: pointnet2",
    "image": "images",
}


class SteeringNet(nn.Module):
    """Steering from windows of frames. Letters: B frames, W windows of T frames, F features.

    If `equivariant`, a mirrored world steers exactly the other way, as it does under the bicycle model: features are
    what the spatial network sees minus what it sees in the mirror, and the recurrent one counts its answer to them
    against that to their negative. What is the same on both sides, most of a street, is gone before the recurrent
    network hears it. The paper has no such symmetry.

    With `motion` the recurrent network hears besides what the car did since the frame before, and says what the angle
    measured from that leaves open, in units of its deviation. The paper has no such input.
    """

    def __init__(
        self, spatial: nn.Module, temporal: RecurrentCell, equivariant: bool = False, motion: bool = False
    ) -> None:
        super().__init__()
        self.spatial = spatial
        self.temporal = temporal
        self.equivariant = equivariant
        self.motion = motion

    def encode(self, batch: Batch) -> Tensor:
        """Return what the spatial network sees in each frame, [B,F]; minus the same in the mirror, if equivariant."""
        if not self.equivariant:
            features: Tensor = self.spatial(batch)
            return features
        # A network that has `both` shares what the two have in common.
        both = getattr(self.spatial, "both", lambda batch: (self.spatial(batch), self.spatial(batch.mirrored())))
        seen, mirrored = both(batch)
        return seen - mirrored

    def forward(self, batch: Batch, windows: Tensor, dt_s: Tensor, motion: Tensor | None = None) -> Tensor:
        """Predict the (scaled) steering at each window's last frame, or what the measured angle leaves open of it.

        Windows may overlap: each frame is encoded once, however many windows hold it.

        Args:
            batch: B frames.
            windows: int64 [W,T], which frames of the batch a window holds, oldest first.
            dt_s: [W,T] seconds since the frame before.
            motion: [B,4], see motion.py; of a network with motion.
        Returns:
            [W]
        """
        return self.recall(self.encode(batch), windows, dt_s, motion)

    def recall(self, features: Tensor, windows: Tensor, dt_s: Tensor, motion: Tensor | None = None) -> Tensor:
        """Predict as `forward` does, of frames that are encoded already: their features [B,F]."""
        with torch.autocast(features.device.type, enabled=False):  # a tiny part of the work, and an ODE
            odd, even = self._heard(features, motion)
            out, _ = self._last(torch.cat([odd, even], dim=1), windows, dt_s)
            if self.equivariant:
                mirrored, _ = self._last(torch.cat([-odd, even], dim=1), windows, dt_s)
                out = (out - mirrored) / 2
            return out

    def activity(self, batch: Batch, windows: Tensor, dt_s: Tensor, motion: Tensor | None = None) -> Tensor:
        """Return the recurrent network's state at each window's end, [W,U]; arguments as of `forward`."""
        _, state = self._last(torch.cat(self._heard(self.encode(batch), motion), dim=1), windows, dt_s)
        return torch.cat(state, dim=1)

    def _heard(self, features: Tensor, motion: Tensor | None) -> tuple[Tensor, Tensor]:
        """What the recurrent network hears of each frame: what a mirror turns round, and what not, each [B,..]."""
        features = features.to(next(self.temporal.parameters()).dtype)
        if not self.motion:
            return features, features.new_empty(len(features), 0)
        if motion is None:
            raise ValueError("a network with motion needs that of each frame")
        of_car, even = odd_and_even(motion.to(features))
        return torch.cat([features, of_car], dim=1), even

    def _last(self, heard: Tensor, windows: Tensor, dt_s: Tensor) -> tuple[Tensor, State]:
        """What is heard of each frame [B,D] → what the recurrent network says at each window's end, [W]; its state."""
        sensed = self.temporal.sense(heard)  # [B,S]
        out, state = self.temporal(sensed[windows], dt_s.to(sensed))  # [W,T,1]
        return out[:, -1, 0], state


def build(line: Line, kind: Kind = "graph", levels: int = 0, image_size: tuple[int, int] | None = None) -> SteeringNet:
    """Build the network of a model's line of params.yaml, with new weights from torch's random state.

    Args:
        line: `input`, `spatial`, `temporal`, `window`, `features`, `equivariant`, `motion` if it is not none, and knobs
            of the two networks.
        kind: what the frames of the line's input are.
        levels: PointNet++'s samplings in the input, if it is of that kind.
        image_size: (H,W) pixels of the input's images, if it is of that kind.
    Raises:
        ValueError: an unknown network or cell, an input that the spatial network is not made for, a knob that means
            nothing to the two, a value that a knob cannot have. It starts with the key: "semantics = 1.5: …".
    """
    spatial, _ = networks = _networks(line)
    expected: Any = getattr(spatial.module, "INPUT", None)
    if expected not in KINDS:
        raise ValueError(f"{spatial.path} needs a line INPUT: Kind = … , one of {', '.join(KINDS)}")
    if expected != kind:
        raise ValueError(
            f"spatial = {spatial.name!r} expects {KINDS[expected]}, but input: {line['input']} holds {KINDS[kind]}: "
            "change one"
        )
    _refuse_what_means_nothing(line, networks)
    settings = [network.settings(line) for network in networks]
    of_kind: dict[Kind, dict[str, Any]] = {
        "graph": {},
        "pointnet2": {"levels": levels},
        "image": {"image_size": image_size},
    }
    given = {"features": line["features"], "window": line["window"], **of_kind[kind]}
    motion = line.get("motion", "none") != "none"
    heard_of_each = [given, given | {"features": line["features"] + motion * COLUMNS}]
    # Random numbers are drawn in this order: a seed's weights depend on it.
    each, over = (network.build(*of) for network, *of in zip(networks, heard_of_each, settings, strict=True))
    return SteeringNet(each, over, line["equivariant"], motion)


def knobs(line: Line) -> list[str]:
    """Return the keys that mean something to the networks of a line, beside GENERAL. Raises ValueError as `build`."""
    return [knob for network in _networks(line) for knob in network.knobs]


def resolved(line: Line) -> dict[str, Any]:
    """Return a line with all that its networks were built with, defaults included. Raises ValueError as `build`."""
    whole = {key: line[key] for key in GENERAL if key in line}
    networks = _networks(line)
    _refuse_what_means_nothing(line, networks)
    for network in networks:
        whole |= {key: plain(network.annotation(key), value) for key, value in network.settings(line).items()}
    return whole


def modules(line: Line) -> list[str]:
    """Return the dotted names of the files that a line names: imports do not show them. Raises ValueError."""
    whole = resolved(line)
    return [load(part, whole[part]).__name__ for part in get_args(Part) if part in whole]


def _networks(line: Line) -> tuple[Network, Network]:
    return Network("spatial", line["spatial"]), Network("temporal", line["temporal"])


def _refuse_what_means_nothing(line: Line, networks: tuple[Network, Network]) -> None:
    spatial, temporal = networks
    known = [*spatial.knobs, *temporal.knobs]
    for key in known:
        if key in GENERAL or known.count(key) > 1:
            raise ValueError(f"{key} is defined twice: rename the knob in {spatial.path} or {temporal.path}")
    for key, value in line.items():
        if key not in known and key not in GENERAL:
            raise ValueError(
                f"{written(key, value)} means nothing to spatial: {spatial.name} with temporal: {temporal.name}, "
                f"which take {', '.join(known) or 'no knobs'}: {meant(key, [*known, *GENERAL], 'leave it out')}"
            )


def parameter_count(model: nn.Module) -> int:
    """Return how many numbers training may change."""
    return sum(parameter.numel() for parameter in model.parameters() if parameter.requires_grad)


def predict(net: SteeringNet, arrays: Mapping[str, Array]) -> Tensor:
    """Return the network's output [W] for arrays: a batch of frames', `windows` [W,T], `dt_s` [W,T], `motion` [B,4]."""
    output: Tensor = net(*_inputs(net, arrays))
    return output


def _inputs(net: SteeringNet, arrays: Mapping[str, Array]) -> tuple[Batch, Tensor, Tensor, Tensor | None]:
    return of_arrays(arrays).to(next(net.parameters()).device), *_windows(net, arrays)


def _windows(net: SteeringNet, arrays: Mapping[str, Array]) -> tuple[Tensor, Tensor, Tensor | None]:
    device = next(net.parameters()).device
    windows, dt_s = (torch.as_tensor(arrays[name]).to(device) for name in ("windows", "dt_s"))
    motion = torch.as_tensor(arrays["motion"]).to(device) if "motion" in arrays else None
    return windows, dt_s, motion


def activity(net: SteeringNet, arrays: Mapping[str, Array]) -> Tensor:
    """Return the recurrent network's state at each window's end [W,U]; arrays as of :func:`predict`."""
    state: Tensor = net.activity(*_inputs(net, arrays))
    return state


def wiring_of(line: Line) -> Wiring | None:
    """Return the wiring of a resolved line's recurrent network, if it has one."""
    if "wiring" not in line:
        return None
    inputs = line["features"] + COLUMNS * (line.get("motion", "none") != "none")
    return ncp(inputs, Sizes(**line["wiring"]))


def recall(net: SteeringNet, features: Tensor, arrays: Mapping[str, Array]) -> Tensor:
    """Return the network's output [W] for frames that are encoded, and the arrays of :func:`predict` beside them."""
    return net.recall(features, *_windows(net, arrays))


def encode(net: SteeringNet, arrays: Mapping[str, Array]) -> Tensor:
    """Return the spatial features [B,F] of a batch of arrays."""
    return net.encode(of_arrays(arrays).to(next(net.parameters()).device))
