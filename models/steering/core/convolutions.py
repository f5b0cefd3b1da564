"""Graph convolutions of whole frames on a CPU, tile by tile of points: what is worked on stays in a core's cache."""

from collections.abc import Sequence
from itertools import pairwise, starmap
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from models.steering.core.adjacency import normalised_adjacency, rows_of
from models.steering.core.batch import GraphBatch
from models.steering.core.features import mean_max_pool, node_features

TILE = 2048  # points; with 64 channels and two sides 1 MB in float32


def convolved(batch: GraphBatch, semantics: float, sides: int, parameters: Sequence[Tensor]) -> Tensor:
    """Node features → graph convolutions (paper eq. 3) with ReLU → mean ‖ max over each frame's points.

    S `sides` of the world go side by side. They share the graph and the first layer's sparse product, whose weight is
    as wide as all of them; a later layer has one weight for all, and its sparse product, S times as wide, reads the
    graph's indices once. A row is a point, [n, S C], or seen otherwise a side of a point, [n S, C].

    Args:
        semantics: λ of node_features.
        parameters: weight and bias of each layer: [25, S C], [S C], then [C, C'], [C'], …
    Returns:
        [B, S, 2C]. There is no gradient of the points' places.
    """
    pooled: Tensor = _Convolutions.apply(batch, semantics, *parameters)  # type: ignore[no-untyped-call]
    return pooled.view(batch.frames, 2, sides, -1).transpose(1, 2).flatten(2)


class _Block(NamedTuple):
    """What is kept of a block of b frames for the gradients.

    What a layer hears is Â H. Its answer is one dense product away, and cheaper to work out again than to write down
    and to read.
    """

    tiles: list[tuple[slice, Tensor]]  # rows, and these rows of the adjacency matrix, sparse [rows, n]
    heard: list[list[Tensor]]  # by layer, by tile: [rows S, C]; of the first layer [rows, 25]
    frames: list[slice]  # rows of each
    top: Tensor  # [b, S C], the maximum over a frame's points
    ties: Tensor  # [b, S C], how many points have it

    def of_points(self, rows: slice, answer: Tensor, of_pooled: Tensor) -> Tensor:
        """Return the gradient of the last layer's answer on these rows, [rows, S C], from that of mean ‖ max [b,2SC].

        Equal maxima share it.
        """
        gradient = torch.empty_like(answer)
        of_mean, of_max = of_pooled.chunk(2, dim=1)
        of_max = of_max / self.ties
        for frame, its in enumerate(self.frames):
            part = slice(max(its.start, rows.start) - rows.start, min(its.stop, rows.stop) - rows.start)
            if part.start < part.stop:
                top = _reaches(answer[part], self.top[frame])
                torch.addcmul(of_mean[frame] / (its.stop - its.start), top, of_max[frame], out=gradient[part])
        return gradient


class _Convolutions(torch.autograd.Function):
    """Blocks of whole frames, one after the other: a block is one tile, or one frame of several."""

    @staticmethod
    def forward(ctx: Any, batch: GraphBatch, semantics: float, *parameters: Tensor) -> Tensor:
        ctx.save_for_backward(*parameters)
        ctx.blocks, pooled, dtype = [], [], parameters[0].dtype
        for block in batch.blocks(TILE):
            tiles = _tiles(normalised_adjacency(block.degree, block.indices, dtype))
            x, heard = node_features(block.xyz.to(dtype), block.cls, semantics), []  # [n,25]
            for weight, bias in _pairs(parameters):
                answer, of_tiles = x.new_empty(len(x), x.shape[1] // len(weight) * len(bias)), []
                for rows, matrix in tiles:
                    of_tiles.append((matrix @ x).view(-1, len(weight)))
                    torch.addmm(bias, of_tiles[-1], weight, out=answer[rows].view(-1, len(bias))).relu_()
                heard.append(of_tiles)
                x = answer
            pooled.append(mean_max_pool(x, block.ptr))
            if any(ctx.needs_input_grad):
                frames, top = list(starmap(slice, pairwise(block.ptr.tolist()))), pooled[-1][:, x.shape[1] :]
                ties = torch.stack([_ties(x[rows], of) for rows, of in zip(frames, top, strict=True)])
                ctx.blocks.append(_Block(tiles, heard, frames, top, ties))
        return torch.cat(pooled)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        layers, totals = _pairs(ctx.saved_tensors), [torch.zeros_like(parameter) for parameter in ctx.saved_tensors]
        of_blocks = torch.split(gradient, [len(block.frames) for block in ctx.blocks])
        for block, of_pooled in zip(ctx.blocks, of_blocks, strict=True):
            points, sides = block.tiles[-1][0].stop, block.top.shape[1] // len(layers[-1][1])
            of_heard: Tensor | None = None  # the gradient of what the layer above hears, [n, S C]
            for number in reversed(range(len(layers))):
                (weight, bias), (of_weight, of_bias) = layers[number], _pairs(totals)[number]
                below = weight.new_empty(points, sides * len(weight)) if number else None
                for (rows, matrix), heard in zip(block.tiles, block.heard[number], strict=True):
                    answer = torch.addmm(bias, heard, weight).relu_()
                    if of_heard is None:
                        of_answer = block.of_points(rows, answer.view(rows.stop - rows.start, -1), of_pooled)
                    else:
                        of_answer = matrix @ of_heard  # the matrix is symmetric
                    of_sum = torch.ops.aten.threshold_backward(of_answer.view_as(answer), answer, 0)  # that of ReLU
                    of_weight.addmm_(heard.T, of_sum)
                    of_bias += of_sum.sum(0)
                    if below is not None:
                        torch.mm(of_sum, weight.T, out=below[rows].view(-1, len(weight)))
                of_heard = below
        return None, None, *totals


def _tiles(matrix: Tensor) -> list[tuple[slice, Tensor]]:
    points = len(matrix)
    if points <= TILE:
        return [(slice(0, points), matrix)]
    edges = pairwise([*range(0, points, TILE), points])
    return [(slice(first, last), rows_of(matrix, first, last)) for first, last in edges]


def _reaches(x: Tensor, top: Tensor) -> Tensor:
    """Return 1 where x [n,C] has the value of top [C], else 0; as numbers it is six times as fast as with bool."""
    return torch.eq(x, top, out=torch.empty_like(x))


def _ties(x: Tensor, top: Tensor) -> Tensor:
    """Return how many of the points x [n,C] reach the top [C]."""
    return torch.stack([_reaches(tile, top).sum(0) for tile in torch.split(x, TILE)]).sum(0)


def _pairs(parameters: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
    return list(zip(parameters[::2], parameters[1::2], strict=True))
