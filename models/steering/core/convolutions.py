"""Graph convolutions of complete frames on a CPU, in tiles of points that fit a core's cache."""

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise, starmap
from typing import Any, NamedTuple, TypeVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from models.steering.core.adjacency import csr_rows, normalised_adjacency
from models.steering.core.batch import GraphBatch
from models.steering.core.features import mean_max_pool, node_features

T = TypeVar("T")
R = TypeVar("R")
_POOL = ThreadPoolExecutor(len(os.sched_getaffinity(0)), "convolve", initializer=partial(torch.set_num_threads, 1))
TILE = 2048  # points; with 64 channels and two versions 1 MB in float32


class _Block(NamedTuple):
    """Values of a block of b frames that backward needs.

    A layer's input is Â H. Its output is one dense product away, which is cheaper to repeat than to store and read.
    """

    tiles: list[tuple[slice, Tensor]]  # rows, and these rows of the adjacency matrix, sparse [rows, n]
    inputs: list[list[Tensor]]  # by layer, by tile: [rows S, C]; first layer [rows, 25]
    frames: list[slice]  # rows of each
    top: Tensor  # [b, S C], the maximum over a frame's points
    ties: Tensor  # [b, S C], number of points with the maximum

    def pooling_gradient(self, rows: slice, output: Tensor, grad_pooled: Tensor) -> Tensor:
        """Return the gradient of the last layer's output on `rows` [rows, S C], given the one of mean ‖ max [b,2SC].

        Equal maxima share the gradient.
        """
        gradient = torch.empty_like(output)
        grad_mean, grad_max = grad_pooled.chunk(2, dim=1)
        grad_max = grad_max / self.ties
        for number, frame in enumerate(self.frames):
            part = slice(max(frame.start, rows.start) - rows.start, min(frame.stop, rows.stop) - rows.start)
            if part.start < part.stop:
                top = _equals(output[part], self.top[number])
                mean = grad_mean[number] / (frame.stop - frame.start)
                torch.addcmul(mean, top, grad_max[number], out=gradient[part])
        return gradient


class Convolutions(torch.autograd.Function):
    """Graph convolutions (paper eq. 3) with ReLU on the node features, then pooling: mean ‖ max over each frame.

    S versions of the node features are convolved together (original and mirrored). They share the graph and the first
    layer's sparse product, its weight is S times as wide. A later layer has one weight for all versions, and its sparse
    product, S times as wide, reads the graph's indices once. The same array is viewed as [n, S C] and as [n S, C].

    Works block by block: a block is one tile of complete frames, or one frame of several tiles. Blocks are computed
    side by side. Gradients are summed in the order of the blocks, whatever the number of threads.

    Args: batch; λ of node_features; weight and bias of each layer: [25, S C], [S C], then [C, C'], [C'], …
    Returns: [B, 2 S C]. Without a gradient for the points' positions.
    """

    @staticmethod
    def forward(ctx: Any, batch: GraphBatch, semantics: float, *parameters: Tensor) -> Tensor:
        ctx.save_for_backward(*parameters)
        keep = any(ctx.needs_input_grad)

        def convolve(block: GraphBatch) -> tuple[Tensor, _Block | None]:
            return _forward(block, semantics, _pairs(parameters), keep)

        pooled, ctx.blocks = zip(*_side_by_side(convolve, batch.blocks(TILE)), strict=True)
        return torch.cat(pooled)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        layers = _pairs(ctx.saved_tensors)

        def differentiate(part: tuple[_Block, Tensor]) -> list[Tensor]:
            return _backward(*part, layers)

        parts = zip(ctx.blocks, torch.split(gradient, [len(block.frames) for block in ctx.blocks]), strict=True)
        totals = [torch.zeros_like(parameter) for parameter in ctx.saved_tensors]
        for gradients in _side_by_side(differentiate, parts):
            torch._foreach_add_(totals, gradients)
        return None, None, *totals


@torch.no_grad()  # a thread of the pool starts with gradients
def _forward(
    block: GraphBatch, semantics: float, layers: Sequence[tuple[Tensor, Tensor]], keep: bool
) -> tuple[Tensor, _Block | None]:
    """Return mean ‖ max of a block's frames [b, 2SC], and what backward needs if `keep`."""
    dtype = layers[0][0].dtype
    tiles = _tiles(normalised_adjacency(block.degree, block.indices, dtype))
    x, inputs = node_features(block.xyz.to(dtype), block.cls, semantics), []  # [n,25]
    for weight, bias in layers:
        output, layer_inputs = x.new_empty(len(x), x.shape[1] // len(weight) * len(bias)), []
        for rows, matrix in tiles:
            layer_inputs.append((matrix @ x).view(-1, len(weight)))
            torch.addmm(bias, layer_inputs[-1], weight, out=output[rows].view(-1, len(bias))).relu_()
        inputs.append(layer_inputs)
        x = output
    pooled = mean_max_pool(x, block.ptr)
    if not keep:
        return pooled, None
    frames, top = list(starmap(slice, pairwise(block.ptr.tolist()))), pooled[:, x.shape[1] :]
    ties = torch.stack([_ties(x[rows], maximum) for rows, maximum in zip(frames, top, strict=True)])
    return pooled, _Block(tiles, inputs, frames, top, ties)


@torch.no_grad()
def _backward(block: _Block, grad_pooled: Tensor, layers: Sequence[tuple[Tensor, Tensor]]) -> list[Tensor]:
    """Return the gradients of the layers' weights and biases, given the one of a block's mean ‖ max [b, 2SC]."""
    gradients: list[Tensor] = []
    points, versions = block.tiles[-1][0].stop, block.top.shape[1] // len(layers[-1][1])
    grad_above: Tensor | None = None  # gradient of the next layer's input, [n, S C]
    for number in reversed(range(len(layers))):
        weight, bias = layers[number]
        grad_weight, grad_bias = torch.zeros_like(weight), torch.zeros_like(bias)
        below = weight.new_empty(points, versions * len(weight)) if number else None
        for (rows, matrix), inputs in zip(block.tiles, block.inputs[number], strict=True):
            output = torch.addmm(bias, inputs, weight).relu_()
            if grad_above is None:
                grad = block.pooling_gradient(rows, output.view(rows.stop - rows.start, -1), grad_pooled)
            else:
                grad = matrix @ grad_above  # the matrix is symmetric
            grad = torch.ops.aten.threshold_backward(grad.view_as(output), output, 0)  # of ReLU
            grad_weight.addmm_(inputs.T, grad)
            grad_bias += grad.sum(0)
            if below is not None:
                torch.mm(grad, weight.T, out=below[rows].view(-1, len(weight)))
        gradients[:0] = [grad_weight, grad_bias]
        grad_above = below
    return gradients


def _side_by_side(work: Callable[[T], R], items: Iterable[T]) -> Iterable[R]:
    """Return ``work(item)`` of each item in order; the cores share the items, with one torch thread each."""
    items = list(items)
    return _POOL.map(work, items) if len(items) > 1 else map(work, items)


def _tiles(matrix: Tensor) -> list[tuple[slice, Tensor]]:
    points = len(matrix)
    if points <= TILE:
        return [(slice(0, points), matrix)]
    edges = pairwise([*range(0, points, TILE), points])
    return [(slice(first, last), csr_rows(matrix, first, last)) for first, last in edges]


def _equals(x: Tensor, top: Tensor) -> Tensor:
    """Return 1 where x [n,C] equals top [C], else 0. Six times faster than with bool."""
    return torch.eq(x, top, out=torch.empty_like(x))


def _ties(x: Tensor, top: Tensor) -> Tensor:
    """Return the number of points x [n,C] equal to top [C], per channel."""
    return torch.stack([_equals(tile, top).sum(0) for tile in torch.split(x, TILE)]).sum(0)


def _pairs(parameters: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
    return list(zip(parameters[::2], parameters[1::2], strict=True))
