"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

import warnings
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.features import IN_MIRROR, NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.graph_network import GraphNetwork
from models.steering.core.knobs import Fraction, Widths

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


class GCN(GraphNetwork):
    """Graph convolutions, worked off in blocks of frames that a core's cache holds: see _Blockwise.

    On a GPU and in mixed precision they go layer by layer, as the other networks on graphs.
    """

    def __init__(self, features: int, *, layers: Widths = (32, 32, 64), semantics: Fraction = 0.0) -> None:
        super().__init__(GCNLayer, features, layers=layers, semantics=semantics)

    def pooled(self, batch: GraphBatch) -> Tensor:
        return super().pooled(batch) if _layer_by_layer(batch) else self._blockwise(batch, [SEEN])[:, 0]

    def both(self, batch: GraphBatch) -> tuple[Tensor, Tensor]:
        """Return what `forward` says of the frames, and of the same in the mirror: each [B, features]."""
        if _layer_by_layer(batch):
            return self(batch), self(batch.mirrored())
        seen, mirrored = self.told(self._blockwise(batch, [SEEN, IN_MIRROR])).unbind(1)
        return seen, mirrored

    def _blockwise(self, batch: GraphBatch, sides: Sequence[Sequence[float]]) -> Tensor:
        """Return mean ‖ max over each frame's points, of each of S sides: [B, S, 2 width]."""
        weight, bias, *later = self.layers.parameters()
        # A mirror changes but the sign of some node features, and in Â H W one may as well change that of W's rows.
        wide = torch.cat([weight * weight.new_tensor(signs)[:, None] for signs in sides], dim=1)
        first = wide, bias.repeat(len(sides))
        pooled: Tensor = _Blockwise.apply(batch, self.semantics, *first, *later)  # type: ignore[no-untyped-call]
        return pooled.view(batch.frames, 2, len(sides), -1).transpose(1, 2).flatten(2)


SEEN = (1.0,) * NODE_FEATURES
BLOCK = 4096  # points; at 64 channels and two sides 2 MB in float32


def _layer_by_layer(batch: GraphBatch) -> bool:
    kind = batch.xyz.device.type
    return kind != "cpu" or torch.is_autocast_enabled(kind)


class _Blockwise(torch.autograd.Function):
    """Node features → graph convolutions with ReLU → mean ‖ max over each frame's points: [B, 2, S C].

    The first layer is as wide as all S sides of the world together, side by side; the later ones have one weight for
    all. So the sides share the graph and the first sparse product, and the later ones, S times as wide, read the
    graph's indices once. A row is a point, [n, S C], or seen otherwise a side of a point, [n S, C].

    Kept for the gradients is what each layer hears, Â H: its answer is one dense product away, and cheaper to work out
    again than to write down and to read. There is no gradient of the points' places.
    Parameters: weight, bias of each layer.
    """

    @staticmethod
    def forward(ctx: Any, batch: GraphBatch, semantics: float, *parameters: Tensor) -> Tensor:
        dtype, pooled = parameters[0].dtype, []
        ctx.save_for_backward(*parameters)
        ctx.blocks = []
        for block in batch.blocks(BLOCK):
            nodes, heard = len(block.xyz), []
            adjacency = normalised_adjacency(block.degree, block.indices, dtype)
            x = node_features(block.xyz.to(dtype), block.cls, semantics)  # [n,25]
            for weight, bias in _pairs(parameters):
                heard.append((adjacency @ x.view(nodes, -1)).view(-1, len(weight)))
                x = torch.addmm(bias, heard[-1], weight).relu_()
            pooled.append(mean_max_pool(x.view(nodes, -1), block.ptr))
            if any(ctx.needs_input_grad):
                ctx.blocks.append((adjacency, heard, block.ptr.diff().tolist()))
        return torch.cat(pooled).view(batch.frames, 2, -1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        layers = _pairs(ctx.saved_tensors)
        totals = [torch.zeros_like(parameter) for parameter in ctx.saved_tensors]
        of_frames = iter(gradient)
        for adjacency, heard, counts in ctx.blocks:
            nodes, upstream = len(adjacency), None  # the gradient of a layer's answer
            of_layers = zip(heard[::-1], layers[::-1], _pairs(totals)[::-1], strict=True)
            for x, (weight, bias), (of_weight, of_bias) in of_layers:
                answer = torch.addmm(bias, x, weight).relu_()
                if upstream is None:
                    frames = torch.split(answer.view(nodes, -1), counts)
                    upstream = torch.cat([_of_points(points, next(of_frames)) for points in frames])
                upstream = torch.ops.aten.threshold_backward(upstream.view_as(answer), answer, 0)  # that of ReLU
                of_weight.addmm_(x.T, upstream)
                of_bias += upstream.sum(0)
                if x is not heard[0]:
                    upstream = adjacency @ (upstream @ weight.T).view(nodes, -1)  # the matrix is symmetric
        return None, None, *totals


def _of_points(points: Tensor, gradient: Tensor) -> Tensor:
    """Return the gradient of a frame's points [n,C] from that of their mean and max [2,C]; equal maxima share it."""
    if not len(points):
        return points
    of_mean, of_max = gradient
    top = torch.eq(points, points.amax(0), out=torch.empty_like(points))  # as numbers: six times as fast as bool
    return torch.addcmul(of_mean / len(points), top, of_max / top.sum(0))


def _pairs(parameters: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
    return list(zip(parameters[::2], parameters[1::2], strict=True))


network = GCN
