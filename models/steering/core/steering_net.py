"""The paper's figure: a spatial network on each frame, a recurrent one over the frames."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.cell.cfc import CfC
from models.steering.cell.eq4 import Eq4
from models.steering.cell.ltc import LTC
from models.steering.core import batch as frames
from models.steering.core.graph_network import GraphNetwork
from models.steering.core.recurrent import LSTM, RecurrentCell
from models.steering.core.wiring import Wiring, ncp
from models.steering.spatial.cnn import SteeringCNN
from models.steering.spatial.edgeconv import EdgeConvLayer
from models.steering.spatial.gatv2 import GATv2Layer
from models.steering.spatial.gnn import GCNLayer
from models.steering.spatial.pointnet2 import PointNet2

Line = dict[str, Any]  # a model's line of params.yaml

SPATIAL: dict[str, Callable[[Line], nn.Module]] = {
    "gnn": lambda line: GraphNetwork(GCNLayer, line["layers"], line["features"], line["semantics"]),
    "edgeconv": lambda line: GraphNetwork(EdgeConvLayer, line["layers"], line["features"], line["semantics"]),
    "gatv2": lambda line: GraphNetwork(GATv2Layer, line["layers"], line["features"], line["semantics"]),
    "pointnet2": lambda line: PointNet2(line["levels"], line["width"], line["features"], line["semantics"]),
    "cnn": lambda line: SteeringCNN(line["image_size"], line["features"]),
}
# What a spatial network's frames must be; those that are not named eat kNN graphs.
EATS = {"pointnet2": "pointnet2", "cnn": "image"}
KINDS = {
    "graph": "kNN graphs",
    "pointnet2": "points with neighbourhood: pointnet2",
    "image": "images (a variant with cloud: none)",
}
CELL: dict[str, Callable[[Wiring], RecurrentCell]] = {"ltc": LTC, "eq4": Eq4, "cfc": CfC}
DEFAULT_CELL = "ltc"  # of a line that names none, whatever its temporal network
TEMPORAL: dict[str, Callable[[Line], RecurrentCell]] = {
    "ncp": lambda line: CELL[line["cell"]](ncp(line["features"], **line["wiring"])),
    "lstm": lambda line: LSTM(line["features"], line["units"]),
}


class SteeringNet(nn.Module):
    """Steering from windows of frames. Letters: B frames, W windows of T frames, F features.

    If `equivariant`, a mirrored world steers exactly the other way, as it does under the bicycle model: features are
    what the spatial network sees minus what it sees in the mirror, and the recurrent one counts its answer to them
    against that to their negative. What is the same on both sides, most of a street, is gone before the recurrent
    network hears it. The paper has no such symmetry.
    """

    def __init__(self, spatial: nn.Module, temporal: RecurrentCell, equivariant: bool = False) -> None:
        super().__init__()
        self.spatial = spatial
        self.temporal = temporal
        self.equivariant = equivariant

    def encode(self, batch: frames.Batch) -> Tensor:
        """Return what the spatial network sees in each frame, [B,F]; minus the same in the mirror, if equivariant."""
        features: Tensor = self.spatial(batch)
        return features - self.spatial(batch.mirrored()) if self.equivariant else features

    def forward(self, batch: frames.Batch, windows: Tensor, dt_s: Tensor) -> Tensor:
        """Predict the (scaled) steering at each window's last frame.

        Windows may overlap: each frame is encoded once, however many windows hold it.

        Args:
            batch: B frames.
            windows: int64 [W,T], which frames of the batch a window holds, oldest first.
            dt_s: [W,T] seconds since the frame before.
        Returns:
            [W]
        """
        features = self.encode(batch)  # [B,F]
        with torch.autocast(features.device.type, enabled=False):  # a tiny part of the work, and an ODE
            dtype = next(self.temporal.parameters()).dtype
            features, dt_s = features.to(dtype), dt_s.to(dtype)
            out = self._last(features, windows, dt_s)
            return (out - self._last(-features, windows, dt_s)) / 2 if self.equivariant else out

    def _last(self, features: Tensor, windows: Tensor, dt_s: Tensor) -> Tensor:
        """Features [B,F] → what the recurrent network says at each window's end, [W]."""
        sensed = self.temporal.sense(features)  # [B,S]
        out, _ = self.temporal(sensed[windows], dt_s)  # [W,T,1]
        return out[:, -1, 0]


def build(line: Line, kind: str = "graph", levels: int = 0, image_size: tuple[int, int] | None = None) -> SteeringNet:
    """Build the network of a model's line of params.yaml, with new weights from torch's random state.

    Args:
        line: `spatial`, `temporal`, `features`, `equivariant`, and what the two networks need: `layers`, `width` and
            `semantics`; `units` (lstm), or `cell` and `wiring` (ncp).
        kind: what the frames of the line's input are, a key of KINDS.
        levels: PointNet++'s samplings in the input, if it is of that kind.
        image_size: (H,W) pixels of the input's images, if it is of that kind.
    Raises:
        ValueError: an unknown network or cell (lists the known ones), a cell for a network that has no choice of one,
            an input that the spatial network does not eat, a semantics out of [0,1], an impossible wiring.
    """
    parts: dict[str, list[str]] = {"spatial": list(SPATIAL), "temporal": list(TEMPORAL), "cell": list(CELL)}
    for part, known in parts.items():
        if line[part] not in known:
            raise ValueError(f"{part}: {line[part]!r} is no network of this project: choose {' | '.join(known)}")
    if line["temporal"] != "ncp" and line["cell"] != DEFAULT_CELL:
        raise ValueError(f"cell: {line['cell']!r} is a cell of temporal: ncp, not of {line['temporal']}: leave it out")
    eats = EATS.get(line["spatial"], "graph")
    if eats != kind:
        raise ValueError(
            f"spatial: {line['spatial']} eats {KINDS[eats]}, and input: {line['input']} holds {KINDS[kind]}: change one"
        )
    spatial = SPATIAL[line["spatial"]]({**line, "levels": levels, "image_size": image_size})
    return SteeringNet(spatial, TEMPORAL[line["temporal"]](line), line["equivariant"])


def parameter_count(model: nn.Module) -> int:
    """Return how many numbers training may change."""
    return sum(parameter.numel() for parameter in model.parameters() if parameter.requires_grad)


def predict(net: SteeringNet, arrays: Mapping[str, np.ndarray]) -> Tensor:
    """Return the network's output [W] for arrays: those of a batch of frames, `windows` [W,T] and `dt_s` [W,T]."""
    device = next(net.parameters()).device
    windows, dt_s = (torch.from_numpy(arrays[name]).to(device) for name in ("windows", "dt_s"))
    output: Tensor = net(frames.of_arrays(arrays).to(device), windows, dt_s)
    return output


def encode(net: SteeringNet, arrays: Mapping[str, np.ndarray]) -> Tensor:
    """Return the spatial features [B,F] of a batch of arrays."""
    return net.encode(frames.of_arrays(arrays).to(next(net.parameters()).device))
