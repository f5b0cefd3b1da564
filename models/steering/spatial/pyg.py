"""Layers of PyTorch Geometric by name: any that takes `x, edge_index`, for instance `layer:
GATv2Conv`.
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
    layer: Annotated[
        str, Field(description="a layer of torch_geometric.nn, for instance GATv2Conv")
    ]
    layer_options: dict[str, Any] = {}  # its keyword arguments
    layers: Widths = (32, 32, 64)  # channels of each layer; attention heads multiply them
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PyG(sizes.features, self)


class PyG(nn.Module):
    """Node features → layers of one class, each with ReLU → mean and maximum over each frame → one
    dense layer.

    Most layers store a row per edge: the demo takes 3.3 GB to train with GATv2Conv and 0.8 GB with
    spatial: gnn. On a GPU their sums over neighbours have no fixed order, so two runs differ by
    rounding. Raises InputError if PyTorch Geometric is missing or has no such layer, or if the
    layer refuses its options, needs more than `x, edge_index`, or does not compute what
    :func:`output_width` expects.
    """

    def __init__(self, features: int, options: Options) -> None:
        super().__init__()
        self.semantics, layer = options.semantics, layer_class(options.layer)
        for key in {"cached", "edge_dim", "in_edge_channels"} & options.layer_options.keys():
            raise InputError(
                "each frame has other edges, without features", f"layer_options.{key}", "Remove it"
            )
        takes = (
            ["nn"]
            if next(iter(signature(layer).parameters), "") == "nn"
            else ["in_channels", "out_channels"]
        )
        width, self.layers = NODE_FEATURES, nn.ModuleList()
        try:
            for outputs in options.layers:
                given = {
                    "in_channels": width,
                    "out_channels": outputs,
                    "nn": nn.LazyLinear(outputs),
                }
                self.layers.append(
                    layer(**{name: given[name] for name in takes}, **options.layer_options)
                )
                width = output_width(self.layers[-1], width, outputs)
        except Exception as error:  # of any type, by the layer
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


def output_width(layer: nn.Module, inputs: int, outputs: int) -> int:
    """Return the channels of a layer's output, from a run on two small graphs, which gives a
    LazyLinear its weights.

    Raises ValueError unless it is [N, outputs] or a multiple, and depends on the edges and on
    nothing but the frame.
    """
    path, star = torch.zeros(2, 8, 8)
    path[0, 1] = path[1, 2] = star[0, 1:] = 1  # the other points of the first have no edges
    x = torch.arange(8 * inputs).view(8, inputs).sin()
    both_paths = torch.block_diag(path, star.flip(0, 1))  # type: ignore[no-untyped-call]
    graphs = (x, path), (x, star), (torch.cat([x, x.flip(0)]), both_paths)
    with torch.no_grad():
        first, second, both = (
            layer.eval()(x, (links + links.T).nonzero().T.flip(0)) for x, links in graphs
        )
    layer.train()
    if first.ndim != 2 or len(first) != 8 or first.shape[1] % outputs:
        raise ValueError(f"its output is {list(first.shape)} for 8 points, expected [8, {outputs}]")
    if torch.allclose(first, second, 1e-4, 1e-5):
        raise ValueError("edges have no effect on its output")
    if not torch.allclose(both, torch.cat([first, second.flip(0)]), 1e-4, 1e-5):
        raise ValueError("its output depends on the order of points or on other frames of a batch")
    return first.shape[1]


def layer_class(name: str) -> type[nn.Module]:
    """Return a layer of torch_geometric.nn. Raises InputError if the package is missing or has no
    such layer.
    """
    try:
        from torch_geometric.nn import conv
    except ImportError as error:
        raise InputError(
            "spatial: pyg needs the package torch_geometric", fix="pip install '.[pyg]'"
        ) from error
    reads = {known: [*signature(getattr(conv, known).forward).parameters] for known in conv.__all__}
    suitable = [known for known, names in reads.items() if names[1:3] == ["x", "edge_index"]]
    if name not in suitable:
        raise InputError(
            f"torch_geometric has no layer {name!r} that takes x, edge_index: "
            f"{closest(name, suitable)}"
        )
    return getattr(conv, name)
