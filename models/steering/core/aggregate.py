"""Aggregate functions of neighbours that are not a matrix product, without storing a row per edge."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from models.steering.core.batch import GraphBatch

# Edges per chunk. On a CPU 4 MB in float32 at 64 channels, about a core's cache; on a GPU 256 MB, for few launches.
EDGES = {"cpu": 1 << 14, "cuda": 1 << 20}
Chunks = list[tuple[Tensor, Tensor, Tensor | None]]
"""Node numbers [n], their neighbours' numbers [n,d], and which of them count, bool [n,d]; None: all."""


def neighbourhoods(batch: GraphBatch, *, loops: bool) -> Chunks:
    """Split a batch's graph into chunks of about EDGES edges.

    On a CPU the nodes of a chunk have equal degrees. On a GPU degrees between two powers of two share a chunk.
    `loops`: add each node as its own first neighbour. Otherwise nodes without neighbours are in no chunk.
    """
    degree, indices, on_cpu = batch.degree, batch.indices, batch.degree.device.type == "cpu"
    # The program would wait for a GPU to read the sizes of chunks from it.
    counts = (degree if batch.cpu_degree is None else batch.cpu_degree).bincount().tolist()
    powers = {1 + (1 << power) for power in range(8) if 1 << power < len(counts)}
    bounds = range(len(counts) + 1) if on_cpu else sorted({0, 1, len(counts)} | powers)
    starts, order = degree.long().cumsum(0) - degree.long(), degree.argsort(stable=True)
    chunks: Chunks = []
    last = 0
    for low, high in pairwise(bounds):  # nodes with low <= degree < high
        first, last = last, last + sum(counts[low:high])
        if first == last or not (loops or low):
            continue
        nodes, slots = order[first:last], torch.arange(high - 1, device=degree.device)
        entries = starts[nodes, None] + slots
        mask: Tensor | None = None
        if high - low > 1:
            entries, mask = entries.clamp_max(len(indices) - 1), slots < degree[nodes, None]
        neighbours = indices[entries].long()
        if loops:
            neighbours = torch.cat([nodes[:, None], neighbours], dim=1)
            mask = mask if mask is None else nn.functional.pad(mask, (1, 0), value=True)
        rows = max(1, EDGES[degree.device.type] // neighbours.shape[1])
        parts = torch.split(nodes, rows)
        masks = [None] * len(parts) if mask is None else torch.split(mask, rows)
        chunks += zip(parts, torch.split(neighbours, rows), masks, strict=True)
    return chunks


def aggregate(function: Callable[..., Tensor], graph: Chunks, x: Tensor, centre: Tensor, *shared: Tensor) -> Tensor:
    """Apply `function` to each node's neighbours; memory grows with nodes, not with edges.

    Args:
        function: (x of the neighbours [n,d,C], `centre` of the nodes [n,C], *shared) → [n,C]; runs again in backward.
            Its argument `valid` bool [n,d] tells which neighbours count; None: all.
        graph: from `neighbourhoods`.
        x, centre: [N,C]
        shared: parameters of `function`.
    Returns:
        [N,C]; zeros for nodes without neighbours.
    """
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
            for nodes, neighbours, valid in chunks:
                out[nodes] = function(_rows(x, neighbours), centre[nodes], *shared, valid=valid)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        x, centre, *shared = ctx.saved_tensors
        grad_x, grad_centre, *grad_shared = (torch.zeros_like(tensor) for tensor in (x, centre, *shared))
        for nodes, neighbours, valid in ctx.chunks:
            pieces = [piece.detach().requires_grad_() for piece in (_rows(x, neighbours), centre[nodes], *shared)]
            with torch.enable_grad(), torch.autocast(x.device.type, enabled=False):
                out = ctx.function(*pieces, valid=valid)
            grad_rows, grad_nodes, *grad_parameters = torch.autograd.grad(out, pieces, gradient[nodes])
            grad_x.index_add_(0, neighbours.flatten(), grad_rows.flatten(0, 1))
            grad_centre[nodes] = grad_nodes
            for total, part in zip(grad_shared, grad_parameters, strict=True):
                total += part
        return None, None, grad_x, grad_centre, *grad_shared


def _rows(x: Tensor, neighbours: Tensor) -> Tensor:
    return x.index_select(0, neighbours.flatten()).view(*neighbours.shape, -1)  # [n,d,C]
