"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

import warnings
from itertools import pairwise
from typing import Any

import torch
from pydantic import Field
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.features import (
    MIRROR_SIGNS,
    NODE_FEATURES,
    mean_max_pool,
    node_features,
)
from models.steering.core.options import NetworkOptions, Semantics, Sizes, Widths


class Options(NetworkOptions):
    kind = "graph"
    reads_edges = True
    layers: Widths = Field(default=(32, 32, 64), description="channels after each layer")
    semantics: Semantics

    def build(self, sizes: Sizes) -> nn.Module:
        return GCN(sizes.features, self)


class GCNLayer(nn.Module):
    """Graph convolution H ↦ ReLU(D̃^(-1/2) Ã D̃^(-1/2) H W + b) with Ã = A + I, paper eq. 3."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_uniform_(self.weight)

    def forward(self, adjacency: Tensor, x: Tensor) -> Tensor:
        """Convolve features [N, inputs] → [N, outputs].

        `adjacency` is the matrix [N,N] of :func:`normalised_adjacency`.
        """
        return self.project_features(propagate(adjacency, x), self.weight)

    def project_features(self, propagated: Tensor, weight: Tensor) -> Tensor:
        """Return ReLU(ÂH W + b) of a product ÂH [N, inputs], with `weight` as W."""
        # In place, since each pass over [N, outputs] takes longer than the arithmetic.
        return (propagated @ weight).add_(self.bias).relu_()


class GCN(nn.Module):
    """Node features, graph convolutions, pooling over each frame's points, and one dense layer."""

    # Number of points that a CPU convolves at once. With 64 channels, their features take 2 MB, and
    # the gradients 2 MB more, which is about the size of a core's cache.
    block = 8192

    mirror_signs: Tensor

    def __init__(self, features: int, options: Options) -> None:
        super().__init__()
        self.semantics = options.semantics
        self.register_buffer("mirror_signs", torch.tensor(MIRROR_SIGNS), persistent=False)
        self.layers = nn.ModuleList()
        for inputs, outputs in pairwise([NODE_FEATURES, *options.layers]):
            self.layers.append(GCNLayer(inputs, outputs))
        self.read_out = nn.Linear(2 * options.layers[-1], features)

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return the features of the frames, [B,F]."""
        (features,) = self._features(batch)
        return features

    def with_mirrored(self, batch: GraphBatch) -> list[Tensor]:
        """Return the features of the frames and those of their mirror images, each [B,F].

        A mirror image has the same edges, and node features that differ in signs. So the adjacency
        and the first product are computed once, and signs are those of the first weights.
        """
        return self._features(batch, with_mirrored=True)

    def _features(self, batch: GraphBatch, *, with_mirrored: bool = False) -> list[Tensor]:
        dtype = self.read_out.weight.dtype
        first: Any
        others: list[Any]
        first, *others = self.layers
        weights = [first.weight]
        if with_mirrored:
            weights.append(first.weight * self.mirror_signs)

        pooled: list[list[Tensor]] = [[] for _ in weights]
        for block in batch.blocks(self.block):
            x = node_features(block.xyz.to(dtype), block.cls, self.semantics)
            adjacency = normalised_adjacency(block.degree, block.indices, dtype)
            propagated = propagate(adjacency, x)
            for weight, blocks in zip(weights, pooled, strict=True):
                x = first.project_features(propagated, weight)
                for layer in others:
                    x = layer(adjacency, x)
                blocks.append(mean_max_pool(x, block.ptr))
        return [self.read_out(torch.cat(blocks)) for blocks in pooled]


def propagate(adjacency: Tensor, x: Tensor) -> Tensor:
    """Return the product of a symmetric sparse matrix [N,N] and x [N,C]."""
    return SymmetricProduct.apply(adjacency, x)  # type: ignore[no-untyped-call]


def normalised_adjacency(degree: Tensor, indices: Tensor, dtype: torch.dtype) -> Tensor:
    """Build D̃^(-1/2) (A + I) D̃^(-1/2), paper eq. 3.

    Returns a sparse CSR matrix [N,N] with E + N entries. In each row the diagonal is first, then
    the neighbours in order. `degree` [N] and `indices` [E] are those of a GraphBatch.
    """
    # A row has an entry for each neighbour, and one on the diagonal.
    nodes = len(degree)
    entries = len(indices) + nodes
    sizes = degree.to(indices.dtype) + 1
    starts = nn.functional.pad(sizes.cumsum(0), (1, 0))

    # The first entry of each row is on the diagonal, where the column is the row. The neighbours
    # are the columns of the other entries.
    row = torch.repeat_interleave(sizes, output_size=entries)
    is_neighbour = torch.ones(entries, dtype=torch.bool, device=degree.device)
    is_neighbour.index_fill_(0, starts[:-1], False)
    column = row.masked_scatter(is_neighbour, indices)

    scale = sizes.to(dtype).rsqrt()  # [N], D̃^(-1/2)
    values = scale.index_select(0, row) * scale.index_select(0, column)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            starts.int(), column.int(), values, (nodes, nodes), check_invariants=False
        )


class SymmetricProduct(torch.autograd.Function):
    """A @ x for a symmetric sparse matrix A [N,N] and x [N,C]."""

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, x: Tensor) -> Tensor:
        ctx.matrix = matrix
        return matrix @ x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:
        # The gradient is Aᵀ times `gradient`, and A = Aᵀ. torch's own backward does not know this
        # and transposes A each time.
        return None, SymmetricProduct.apply(ctx.matrix, gradient)  # type: ignore[no-untyped-call]
