"""Layers of PyTorch Geometric by name: any that takes `x, edge_index`, for instance `layer: GATv2Conv`."""

from difflib import get_close_matches
from inspect import signature
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.batch import FrameKind, GraphBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Semantics, Sizes, Widths


class Options(NetworkOptions):
    """Options of PyG."""

    kind: ClassVar[FrameKind] = "graph"
    layer: Annotated[str, Field(description="a layer of torch_geometric.nn, for instance GATv2Conv")]
    layer_options: dict[str, Any] = {}  # its keyword arguments
    layers: Widths = (32, 32, 64)  # channels of each layer; attention heads multiply them
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return PyG(sizes.features, self)


class PyG(nn.Module):
    """Node features → layers of one class, each with ReLU → mean and maximum over each frame → one dense layer.

    Most layers store a row per edge: the demo takes 3.3 GB to train with GATv2Conv and 0.8 GB with spatial: gnn. On a
    GPU their sums over neighbours have no fixed order, so two runs differ by rounding.

    Raises ValueError if PyTorch Geometric is missing or has no such layer, or the layer refuses its options or needs
    more than `x, edge_index`.
    """

    def __init__(self, features: int, options: Options) -> None:
        super().__init__()
        self.semantics, layer = options.semantics, layer_class(options.layer)
        x, edge_index = torch.zeros(2, NODE_FEATURES), torch.tensor([[0, 1], [1, 0]])
        takes_module = "nn" in signature(layer).parameters
        self.layers = nn.ModuleList()
        try:
            for outputs in options.layers:
                arguments = [nn.LazyLinear(outputs)] if takes_module else [x.shape[1], outputs]
                self.layers.append(layer(*arguments, **options.layer_options))
                with torch.no_grad():  # a run for the width, which also gives a LazyLinear its weights
                    x = self.layers[-1](x, edge_index)
        except Exception as error:  # of any type, by the layer
            raise ValueError(f"layer {options.layer} with options {options.layer_options} fails: {error}") from error
        self.read_out = nn.Linear(2 * x.shape[1], features)

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return [B,F]. Independent of the order of points and of the other frames in the batch."""
        x = node_features(batch.xyz.to(self.read_out.weight.dtype), batch.cls, self.semantics)
        edge_index = batch.edge_index
        for layer in self.layers:
            x = layer(x, edge_index).relu()
        return torch.tanh(self.read_out(mean_max_pool(x, batch.ptr)))  # where LTC synapses are sensitive


def layer_class(name: str) -> type[nn.Module]:
    """Return a layer of torch_geometric.nn. Raises ValueError if the package is missing or has no such layer."""
    try:
        from torch_geometric.nn import conv
    except ImportError as error:
        raise ValueError("spatial: pyg needs the package torch_geometric: pip install '.[pyg]'") from error
    layers: dict[str, type[nn.Module]] = {known: getattr(conv, known) for known in conv.__all__}
    suitable = [known for known in layers if [*signature(layers[known].forward).parameters][1:3] == ["x", "edge_index"]]
    if name not in suitable:
        similar = " or ".join(get_close_matches(name, suitable, cutoff=0))
        raise ValueError(f"torch_geometric.nn has no layer {name!r} that takes x, edge_index: did you mean {similar}?")
    return layers[name]
