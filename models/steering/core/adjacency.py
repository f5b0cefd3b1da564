"""Normalised adjacency matrix of a graph convolution (paper eq. 3; Kipf and Welling 2017) and its product."""

import warnings
from typing import Any

import torch
from torch import Tensor, nn


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


def propagate(adjacency: Tensor, x: Tensor) -> Tensor:
    """Return adjacency @ x for x [N,C] and a symmetric sparse matrix [N,N], in its precision."""
    product: Tensor = _SymmetricProduct.apply(adjacency, x.to(adjacency.dtype))  # type: ignore[no-untyped-call]
    return product


class _SymmetricProduct(torch.autograd.Function):
    """A @ x with the gradient A @ gradient, since A = Aᵀ; torch's own backward would transpose A each time."""

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, x: Tensor) -> Tensor:
        ctx.matrix = matrix
        with torch.autocast(x.device.type, enabled=False):  # torch has no half-precision sparse product
            return matrix @ x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:
        return None, propagate(ctx.matrix, gradient)
