"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

import warnings
from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.features import node_features
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.core.options import Sizes


class GCNLayer(nn.Module):
    """Weight W [inputs, outputs] and bias b of H ↦ σ(D̃^(-1/2) Ã D̃^(-1/2) H W + b) with Ã = A + I."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_uniform_(self.weight)


class GCN(GraphNetwork):
    """Graph convolution network; on a CPU block by block, so that temporaries stay in the cache."""

    block = 8192  # with 64 channels and two versions 4 MB in float32, about a core's cache

    def __init__(self, features: int, options: GraphOptions) -> None:
        super().__init__(GCNLayer, features, options)

    def convolved(self, batch: GraphBatch, versions: int) -> Tensor:
        dtype = self.read_out.weight.dtype
        adjacency = normalised_adjacency(batch.degree, batch.indices, dtype)
        propagate: Any = SymmetricProduct.apply
        layers: Any = self.layers
        first, *later = layers
        # Versions share the first sparse product: mirroring features equals mirroring rows of the weight.
        x = propagate(adjacency, node_features(batch.xyz.to(dtype), batch.cls, self.semantics))  # [N, 25]
        weight = torch.cat([first.weight * signs[:, None] for signs in self.signs[:versions]], dim=1)
        x = torch.addmm(first.bias.repeat(versions), x, weight).relu().view(len(x), versions, first.bias.numel())
        for layer in later:
            inputs, outputs = layer.weight.shape
            if inputs <= outputs:  # the sparse product runs on the narrower side
                x = propagate(adjacency, x.flatten(1)).view_as(x)
                x = nn.functional.linear(x, layer.weight.T, layer.bias)
            else:
                x = x @ layer.weight
                x = propagate(adjacency, x.flatten(1)).view_as(x) + layer.bias
            x = x.relu()  # [N, S, width]
        return x


def normalised_adjacency(degree: Tensor, indices: Tensor, dtype: torch.dtype) -> Tensor:
    """Build D̃^(-1/2) (A + I) D̃^(-1/2), paper eq. 3, as a sparse CSR matrix.

    Args:
        degree: [N], neighbours per node, the node itself excluded.
        indices: int32 or int64 [E], neighbours of node 0, of node 1, …; symmetric: if j is in i's list, i is in j's.
        dtype: of the values.
    Returns:
        [N,N] with E + N entries; in each row the diagonal first, then the neighbours in the given order.
    """
    nodes, entries, device = len(degree), len(indices) + len(degree), degree.device
    sizes = degree.to(indices.dtype) + 1
    row = torch.repeat_interleave(sizes, output_size=entries)  # of each entry
    starts = nn.functional.pad(sizes.cumsum(0), (1, 0))
    neighbour = torch.ones(entries, dtype=torch.bool, device=device).index_fill_(0, starts[:-1], False)
    column = row.masked_scatter(neighbour, indices)

    scale = sizes.to(dtype).rsqrt()  # [N], D̃^(-1/2)
    values = scale.index_select(0, row) * scale.index_select(0, column)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(starts.int(), column.int(), values, (nodes, nodes), check_invariants=False)


class SymmetricProduct(torch.autograd.Function):
    """A @ x for a symmetric sparse matrix A [N,N] and x [N,C], in A's precision.

    The gradient is A @ gradient, since A = Aᵀ; torch's own backward would transpose A each time.
    """

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, x: Tensor) -> Tensor:
        ctx.matrix = matrix
        with torch.autocast(x.device.type, enabled=False):  # torch has no half-precision sparse product
            return matrix @ x.to(matrix.dtype)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:
        return None, SymmetricProduct.apply(ctx.matrix, gradient)  # type: ignore[no-untyped-call]


class Options(GraphOptions):
    """Options of GraphNetwork."""

    def build(self, sizes: Sizes) -> nn.Module:
        return GCN(sizes.features, self)
