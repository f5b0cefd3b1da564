"""Layers of PyTorch Geometric by name, for instance `layer: GATv2Conv`.

Any layer that takes `x, edge_index` is possible.
"""

from inspect import signature
from typing import Any

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Semantics, Sizes, Widths
from pipeline.base.errors import InputError, closest


class Options(NetworkOptions):
    kind = "graph"
    reads_edges = True
    layer: str = Field(
        description="a layer of torch_geometric.nn that takes `x, edge_index`, for instance "
        "GATv2Conv"
    )
    layer_options: dict[str, Any] = Field(
        default={}, description="arguments of the layer, of GATv2Conv for instance `{heads: 4}`"
    )
    layers: Widths = Field(
        default=(32, 32, 64), description="channels of each layer, which attention heads multiply"
    )
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PyG(sizes.features, self)


class PyG(nn.Module):
    """Node features, layers of a class with ReLU, pooling over a frame, and a dense layer.

    Most layers store a row per edge, which takes memory: training on the demo takes 3.3 GB with
    GATv2Conv, 0.8 GB with spatial: gnn. On a GPU, sums over neighbours have no fixed order in these
    layers, so two runs differ by rounding. Raises InputError if PyTorch Geometric is missing or has
    no such layer, or if the layer refuses its options or needs more than `x, edge_index`.
    """

    def __init__(self, features: int, options: Options) -> None:
        super().__init__()
        self.semantics = options.semantics
        layer = layer_class(options.layer)
        for key in {"cached", "edge_dim", "in_edge_channels"} & options.layer_options.keys():
            raise InputError(
                "each frame has other edges, without features", f"layer_options.{key}", "Remove it"
            )
        self.layers = nn.ModuleList()
        width = NODE_FEATURES
        try:
            for outputs in options.layers:
                self.layers.append(build_layer(layer, width, outputs, options.layer_options))
                width = output_width(self.layers[-1], width)
        except Exception as error:  # a layer may raise any type
            raise InputError(
                str(error) or repr(error), f"layer {options.layer} {options.layer_options}"
            ) from error
        self.read_out = nn.Linear(2 * width, features)

    def forward(self, batch: GraphBatch) -> Tensor:
        x = node_features(batch.xyz.to(self.read_out.weight.dtype), batch.cls, self.semantics)
        edge_index = batch.edge_index
        for layer in self.layers:
            x = layer(x, edge_index).relu()
        return self.read_out(mean_max_pool(x, batch.ptr))


def build_layer(
    layer: type[nn.Module], inputs: int, outputs: int, options: dict[str, Any]
) -> nn.Module:
    """Build a layer with new weights.

    Some layers take a network instead of sizes, such as EdgeConv. They get a linear network.
    """
    if next(iter(signature(layer).parameters), "") == "nn":
        return layer(nn=nn.LazyLinear(outputs), **options)
    return layer(in_channels=inputs, out_channels=outputs, **options)


def output_width(layer: nn.Module, inputs: int) -> int:
    """Return the channels of a layer's output, from a run on two connected points.

    The run also gives a LazyLinear its weights.
    """
    edge_index = torch.tensor([[1, 0], [0, 1]])
    layer.eval()
    with torch.no_grad():
        output: Tensor = layer(torch.zeros(2, inputs), edge_index)
    layer.train()
    return output.shape[1]


def layer_class(name: str) -> type[nn.Module]:
    """Return a layer of torch_geometric.nn.

    Raises InputError if the package is missing or has no layer of this name for `x, edge_index`.
    """
    try:
        from torch_geometric.nn import conv
    except ImportError as error:
        raise InputError(
            "spatial: pyg needs the package torch_geometric", fix="pip install '.[pyg]'"
        ) from error
    suitable = []
    for layer in conv.__all__:
        arguments = [*signature(getattr(conv, layer).forward).parameters]
        if arguments[1:3] == ["x", "edge_index"]:
            suitable.append(layer)
    if name not in suitable:
        raise InputError(
            f"torch_geometric has no layer {name!r} that takes x, edge_index: "
            f"{closest(name, suitable)}"
        )
    return getattr(conv, name)
