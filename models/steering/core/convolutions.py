"""Graph convolutions of complete frames on a CPU, in tiles of points that fit a core's cache."""

from collections.abc import Sequence
from itertools import pairwise, starmap
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from models.steering.core.adjacency import csr_rows, normalised_adjacency
from models.steering.core.batch import GraphBatch
from models.steering.core.features import mean_max_pool, node_features

TILE = 2048  # points; with 64 channels and two versions 1 MB in float32


def convolve(batch: GraphBatch, semantics: float, versions: int, parameters: Sequence[Tensor]) -> Tensor:
    """Apply graph convolutions (paper eq. 3) with ReLU to the node features, and pool: mean ‖ max over each frame.

    S `versions` of the node features are convolved together (original and mirrored). They share the graph and the first
    layer's sparse product, its weight is S times as wide. A later layer has one weight for all versions, and its sparse
    product, S times as wide, reads the graph's indices once. The same array is viewed as [n, S C] and as [n S, C].

    Args:
        semantics: λ of node_features.
        parameters: weight and bias of each layer: [25, S C], [S C], then [C, C'], [C'], …
    Returns:
        [B, S, 2C]. Without a gradient for the points' positions.
    """
    pooled: Tensor = _Convolutions.apply(batch, semantics, *parameters)  # type: ignore[no-untyped-call]
    return pooled.view(batch.frames, 2, versions, -1).transpose(1, 2).flatten(2)


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


class _Convolutions(torch.autograd.Function):
    """Convolutions block by block: a block is one tile of complete frames, or one frame of several tiles."""

    @staticmethod
    def forward(ctx: Any, batch: GraphBatch, semantics: float, *parameters: Tensor) -> Tensor:
        ctx.save_for_backward(*parameters)
        ctx.blocks, pooled, dtype = [], [], parameters[0].dtype
        for block in batch.blocks(TILE):
            tiles = _tiles(normalised_adjacency(block.degree, block.indices, dtype))
            x, inputs = node_features(block.xyz.to(dtype), block.cls, semantics), []  # [n,25]
            for weight, bias in _pairs(parameters):
                output, layer_inputs = x.new_empty(len(x), x.shape[1] // len(weight) * len(bias)), []
                for rows, matrix in tiles:
                    layer_inputs.append((matrix @ x).view(-1, len(weight)))
                    torch.addmm(bias, layer_inputs[-1], weight, out=output[rows].view(-1, len(bias))).relu_()
                inputs.append(layer_inputs)
                x = output
            pooled.append(mean_max_pool(x, block.ptr))
            if any(ctx.needs_input_grad):
                frames, top = list(starmap(slice, pairwise(block.ptr.tolist()))), pooled[-1][:, x.shape[1] :]
                ties = torch.stack([_ties(x[rows], maximum) for rows, maximum in zip(frames, top, strict=True)])
                ctx.blocks.append(_Block(tiles, inputs, frames, top, ties))
        return torch.cat(pooled)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        layers, totals = _pairs(ctx.saved_tensors), [torch.zeros_like(parameter) for parameter in ctx.saved_tensors]
        grad_blocks = torch.split(gradient, [len(block.frames) for block in ctx.blocks])
        for block, grad_pooled in zip(ctx.blocks, grad_blocks, strict=True):
            points, versions = block.tiles[-1][0].stop, block.top.shape[1] // len(layers[-1][1])
            grad_above: Tensor | None = None  # gradient of the next layer's input, [n, S C]
            for number in reversed(range(len(layers))):
                (weight, bias), (grad_weight, grad_bias) = layers[number], _pairs(totals)[number]
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
                grad_above = below
        return None, None, *totals


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
