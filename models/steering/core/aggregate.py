"""Aggregate functions of neighbours that are not a matrix product, without storing a row per edge."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from models.steering.core.batch import AnyGraph, Padded, PaddedGraph

EDGES = 1 << 14  # per chunk: at 64 channels 4 MB in float32, about a core's cache
Chunks = list[tuple[Tensor, Tensor]]
"""(node numbers [n], their neighbours' numbers [n,d]) of nodes with d neighbours each."""


def neighbourhoods(batch: AnyGraph, *, loops: bool) -> Chunks | Padded:
    """Split a batch's graph into chunks of about EDGES edges; a padded graph stays complete.

    `loops`: add each node as its own first neighbour. Otherwise nodes without neighbours are in no chunk.
    """
    if isinstance(batch, PaddedGraph):
        numbers, valid = batch.padded()
        if loops:
            numbers = torch.cat([torch.arange(numbers.shape[0])[:, None], numbers], dim=1)
            valid = nn.functional.pad(valid, (1, 0), value=True)
        return Padded(numbers, valid)
    degree, indices = batch.degree, batch.indices
    starts = degree.long().cumsum(0) - degree.long()
    chunks: Chunks = []
    for count in degree.bincount().nonzero()[:, 0].tolist():
        if not count and not loops:
            continue
        nodes = (degree == count).nonzero()[:, 0]
        neighbours = indices[starts[nodes, None] + torch.arange(count, device=degree.device)].long()
        if loops:
            neighbours = torch.cat([nodes[:, None], neighbours], dim=1)
        rows = max(1, EDGES // neighbours.shape[1])
        chunks += zip(torch.split(nodes, rows), torch.split(neighbours, rows), strict=True)
    return chunks


def aggregate(
    function: Callable[..., Tensor], graph: Chunks | Padded, x: Tensor, centre: Tensor, *shared: Tensor
) -> Tensor:
    """Apply `function` to each node's neighbours; memory grows with nodes, not with edges, unless they are padded.

    Args:
        function: (x of the neighbours [n,d,C], `centre` of the nodes [n,C], *shared) → [n,C]; runs again in backward.
            Its argument `valid` bool [n,d] tells which neighbours of a padded graph count; None: all.
        graph: from `neighbourhoods`.
        x, centre: [N,C]
        shared: parameters of `function`.
    Returns:
        [N,C]; zeros for nodes without neighbours.
    """
    if isinstance(graph, Padded):
        padded = function(x[graph.numbers], centre, *shared, valid=graph.valid)
        return torch.where(graph.valid.any(1, keepdim=True), padded, 0.0)
    result: Tensor = _Aggregate.apply(function, graph, x, centre, *shared)  # type: ignore[no-untyped-call]
    return result


class _Aggregate(torch.autograd.Function):
    """One gather per chunk, repeated in backward; gradients add up in place, in a fixed order on a CPU."""

    @staticmethod
    def forward(
        ctx: Any, function: Callable[..., Tensor], chunks: Chunks, x: Tensor, centre: Tensor, *shared: Tensor
    ) -> Tensor:
        ctx.function, ctx.chunks = function, chunks
        ctx.save_for_backward(x, centre, *shared)
        out = torch.zeros_like(centre)
        with torch.autocast(x.device.type, enabled=False):  # backward runs outside of it
            for nodes, neighbours in chunks:
                out[nodes] = function(_rows(x, neighbours), centre[nodes], *shared)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        x, centre, *shared = ctx.saved_tensors
        grad_x, grad_centre, *grad_shared = (torch.zeros_like(tensor) for tensor in (x, centre, *shared))
        for nodes, neighbours in ctx.chunks:
            pieces = [piece.detach().requires_grad_() for piece in (_rows(x, neighbours), centre[nodes], *shared)]
            with torch.enable_grad(), torch.autocast(x.device.type, enabled=False):
                out = ctx.function(*pieces)
            grad_rows, grad_nodes, *grad_parameters = torch.autograd.grad(out, pieces, gradient[nodes])
            grad_x.index_add_(0, neighbours.flatten(), grad_rows.flatten(0, 1))
            grad_centre[nodes] = grad_nodes
            for total, part in zip(grad_shared, grad_parameters, strict=True):
                total += part
        return None, None, grad_x, grad_centre, *grad_shared


def _rows(x: Tensor, neighbours: Tensor) -> Tensor:
    return x.index_select(0, neighbours.flatten()).view(*neighbours.shape, -1)  # [n,d,C]
