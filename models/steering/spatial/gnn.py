"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

import warnings
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.graph_network import GraphNetwork

INPUT: Kind = "graph"


class GCNLayer(nn.Module):
    """H ↦ D̃^(-1/2) Ã D̃^(-1/2) H W + b with Ã = A + I: [N, inputs] → [N, outputs]. The caller adds σ."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_uniform_(self.weight)

    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> Tensor:
        """What a batch's graph gives to all layers: the normalised adjacency matrix, sparse [N,N]."""
        return normalised_adjacency(batch.degree, batch.indices, dtype)

    def forward(self, x: Tensor, adjacency: Tensor) -> Tensor:
        inputs, outputs = self.weight.shape
        if inputs <= outputs:  # the sparse product runs on the narrower side
            return propagate(adjacency, x) @ self.weight + self.bias
        return propagate(adjacency, x @ self.weight) + self.bias


def normalised_adjacency(degree: Tensor, indices: Tensor, dtype: torch.dtype) -> Tensor:
    """Build D̃^(-1/2) (A + I) D̃^(-1/2), paper eq. 3, as a sparse CSR matrix.

    Args:
        degree: [N], neighbours per node; no node is its own neighbour.
        indices: int64 [E], neighbours of node 0, of node 1, …; symmetric: if j is in i's list, i is in j's.
        dtype: of the values.
    Returns:
        [N,N] with E + N entries; in each row the diagonal comes first, then the neighbours as given.
    """
    nodes, entries, device = len(degree), len(indices) + len(degree), degree.device
    node = torch.arange(nodes, device=device)
    row = node.repeat_interleave(degree.long() + 1, output_size=entries)  # of each entry
    starts = torch.zeros(nodes + 1, dtype=torch.int64, device=device)
    starts[1:] = (degree.long() + 1).cumsum(0)
    neighbour = torch.ones(entries, dtype=torch.bool, device=device)
    neighbour[starts[:-1]] = False
    column = row.masked_scatter(neighbour, indices)

    scale = (degree.to(dtype) + 1).rsqrt()  # [N], D̃^(-1/2)
    values = scale[row] * scale[column]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(starts.int(), column.int(), values, (nodes, nodes), check_invariants=False)


def propagate(adjacency: Tensor, x: Tensor) -> Tensor:
    """Return adjacency @ x for a symmetric sparse matrix [N,N] and x [N,C], in the matrix's precision."""
    product: Tensor = _SymmetricProduct.apply(adjacency, x.to(adjacency.dtype))  # type: ignore[no-untyped-call]
    return product


class _SymmetricProduct(torch.autograd.Function):
    """A @ x whose gradient is A @ gradient, since A = Aᵀ: torch's own would transpose the matrix each time."""

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, x: Tensor) -> Tensor:
        ctx.matrix = matrix
        with torch.autocast(x.device.type, enabled=False):  # no half-precision sparse product in torch
            return matrix @ x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:
        return None, propagate(ctx.matrix, gradient)


network = partial(GraphNetwork, GCNLayer)
