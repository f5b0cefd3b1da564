"""Layers of PyTorch Geometric by name, for instance `layer: GATv2Conv`.

Any layer that takes `x, edge_index` is possible.
"""

from inspect import signature
from typing import Annotated, Any

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
    layer: Annotated[
        str, Field(description="a layer of torch_geometric.nn, for instance GATv2Conv")
    ]
    # Keyword arguments of the layer.
    layer_options: dict[str, Any] = {}
    # Channels of each layer; attention heads multiply them.
    layers: Widths = (32, 32, 64)
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PyG(sizes.features, self)


class PyG(nn.Module):
    """Node features, layers of a class with ReLU, pooling over a frame, and a dense layer.

    Most layers store a row per edge, which takes memory: training on the demo takes 3.3 GB with
    GATv2Conv, 0.8 GB with spatial: gnn. On a GPU, sums over neighbours have no fixed order in these
    layers, so two runs differ by rounding. Raises InputError if PyTorch Geometric is missing or has
    no such layer. Raises it, too, if the layer refuses its options, needs more than
    `x, edge_index`, or has outputs that :func:`output_width` refuses.
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
                width = output_width(self.layers[-1], width, outputs)
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


def output_width(layer: nn.Module, inputs: int, outputs: int) -> int:
    """Return the channels of a layer's output, from a run on small graphs of 8 points.

    The run also gives a LazyLinear its weights. Raises ValueError unless the output is
    [N, outputs], or [N, k outputs] with k attention heads. The output of a frame must depend on its
    edges, and neither on the order of its points nor on other frames.
    """
    # The first graph is a path through three points; the other points have no edges. The second is
    # a star around the first point.
    path = torch.zeros(8, 8)
    path[0, 1] = 1
    path[1, 2] = 1
    star = torch.zeros(8, 8)
    star[0, 1:] = 1
    x = torch.arange(8 * inputs).view(8, inputs).sin()

    # A batch has the path as its first frame. The second frame is the star with its points in
    # reverse order.
    batch_x = torch.cat([x, x.flip(0)])
    batch = torch.block_diag(path, star.flip(0, 1))  # type: ignore[no-untyped-call]

    layer.eval()
    with torch.no_grad():
        path_output = layer(x, _edge_index(path))
        star_output = layer(x, _edge_index(star))
        batch_output = layer(batch_x, _edge_index(batch))
    layer.train()

    shape = list(path_output.shape)
    if len(shape) != 2 or shape[0] != 8 or shape[1] % outputs:
        raise ValueError(f"its output is {shape} for 8 points, expected [8, {outputs}]")
    if torch.allclose(path_output, star_output, 1e-4, 1e-5):
        raise ValueError("edges have no effect on its output")
    if not torch.allclose(batch_output, torch.cat([path_output, star_output.flip(0)]), 1e-4, 1e-5):
        raise ValueError("its output depends on the order of points or on other frames of a batch")
    return shape[1]


def _edge_index(links: Tensor) -> Tensor:
    """Return the edges [2,E] of a matrix of links [N,N], in both directions."""
    return (links + links.T).nonzero().T.flip(0)


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
