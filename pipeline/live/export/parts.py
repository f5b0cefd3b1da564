"""The two parts of a trained network as modules of plain tensors: their inputs, by name, and which sizes may change."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch, ImageBatch, Level, SetBatch
from models.steering.core.steering_net import SteeringNet
from pipeline.live.export.plain import Recurrent, Spatial

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Input:
    """An array that a part takes. `shape`: whole numbers, and names of sizes that change from frame to frame."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]
    what: str


@dataclass(frozen=True)
class Part:
    """A module with what it takes and gives."""

    name: str
    module: nn.Module
    inputs: tuple[Input, ...]
    output: Input

    def tensors(self, arrays: Arrays) -> tuple[Tensor, ...]:
        """Return its inputs out of arrays by name; others are ignored."""
        return tuple(torch.from_numpy(arrays[each.name]) for each in self.inputs)

    def dynamic_shapes(self) -> tuple[dict[int, Any], ...]:
        """Return which sizes of the inputs may change, as torch.export asks for it."""
        # torch specialises on 0 and 1: a graph of one point, or without an edge, is another program.
        names = dict.fromkeys(size for each in self.inputs for size in each.shape if isinstance(size, str))
        sizes = {name: torch.export.Dim(name, min=2) for name in names}
        return tuple(
            {axis: sizes[size] for axis, size in enumerate(each.shape) if isinstance(size, str)} for each in self.inputs
        )


def recurrent(net: SteeringNet, window: int, features: int) -> Part:
    """Return the recurrent part: a window's features and times, and motion if it takes it → its answer [1]."""
    inputs = [
        Input("features", "float32", (1, window, features), "of the window's frames, oldest first: the spatial part's"),
        Input("dt_s", "float32", (1, window), "seconds since the frame before, 0.1 where there is none"),
    ]
    if net.motion:
        what = "measured_rad, yaw_rate_radps (both left +), speed_mps, valid (0 or 1), since the frame before"
        inputs.append(Input("motion", "float32", (1, window, 4), what))
    answer = Input("answer", "float32", (1,), "of the window's last frame, in units of std_rad")
    return Part("recurrent", Recurrent(net, window), tuple(inputs), answer)


def spatial(net: SteeringNet, features: int, contents: Mapping[str, Any], frame: Arrays) -> Part:
    """Return the spatial part for frames as `frame`, of these :attr:`pipeline.train.frames.Graphs.contents`."""
    output = Input("features", "float32", (1, features), "of the frame")
    points = (
        Input("xyz", "float32", ("points", 3), "m, camera frame: x right, y down, z forward"),
        Input("cls", "uint8", ("points",), "Cityscapes trainId, 255 = void"),
    )
    if contents["kind"] == "image":
        image = Input("image", "uint8", (1, *contents["image_size"], 3), "RGB")
        return Part("spatial", _OfImage(net), (image,), output)
    if contents["kind"] == "graph":
        of_graph = (
            Input("degree", str(frame["degree"].dtype), ("points",), "neighbours of each point, itself left out"),
            Input(
                "indices", str(frame["indices"].dtype), ("edges",), "neighbours of point 0, of point 1, …; symmetric"
            ),
        )
        return Part("spatial", _OfGraph(net), points + of_graph, output)
    of_levels = []
    for level in range(1, contents["levels"] + 1):
        before = "points" if level == 1 else f"centres_{level - 1}"
        wide = frame[f"neighbours_{level}"].shape[1]
        of_levels += [
            Input(f"centres_{level}", "int64", (f"centres_{level}",), f"which of {before}"),
            Input(f"neighbours_{level}", "int64", (f"centres_{level}", wide), f"which of {before}, of each centre"),
        ]
    return Part("spatial", _OfSets(net), (*points, *of_levels), output)


class _OfImage(Spatial):
    def forward(self, image: Tensor) -> Tensor:
        return self.of_frame(ImageBatch(image))


class _OfGraph(Spatial):
    def forward(self, xyz: Tensor, cls: Tensor, degree: Tensor, indices: Tensor) -> Tensor:
        return self.of_frame(GraphBatch(xyz, cls, _pointer(xyz), degree, indices))


class _OfSets(Spatial):
    def forward(self, xyz: Tensor, cls: Tensor, *levels: Tensor) -> Tensor:
        pairs = zip(levels[::2], levels[1::2], strict=True)
        sampled = tuple(Level(centres, neighbours, _pointer(centres)) for centres, neighbours in pairs)
        return self.of_frame(SetBatch(xyz, cls, _pointer(xyz), sampled))


def _pointer(rows: Tensor) -> Tensor:
    """Return where the rows of the one frame begin and end, int64 [2]."""
    return torch.cat([torch.zeros(1, dtype=torch.int64), torch.full((1,), rows.shape[0], dtype=torch.int64)])
