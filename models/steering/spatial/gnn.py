"""Graph convolution on a symmetric graph (paper eq. 3; Kipf and Welling 2017)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from models.steering.core.adjacency import normalised_adjacency, propagate
from models.steering.core.batch import GraphBatch, Kind
from models.steering.core.convolutions import convolved
from models.steering.core.features import IN_MIRROR, NODE_FEATURES
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


class GCN(GraphNetwork):
    """On a CPU all layers go through one tile of points after the other; see core/convolutions.py.

    On a GPU and in mixed precision all points go through one layer after the other, as in the other networks on graphs.
    """

    def __init__(self, features: int, *, layers: Widths = (32, 32, 64), semantics: Fraction = 0.0) -> None:
        super().__init__(GCNLayer, features, layers=layers, semantics=semantics)

    def pooled(self, batch: GraphBatch) -> Tensor:
        return super().pooled(batch) if _layer_by_layer(batch) else self._convolved(batch, [SEEN])[:, 0]

    def both(self, batch: GraphBatch) -> tuple[Tensor, Tensor]:
        """Return what `forward` says of the frames, and of the same in the mirror: each [B, features]."""
        if _layer_by_layer(batch):
            return self(batch), self(batch.mirrored())
        seen, mirrored = self.told(self._convolved(batch, [SEEN, IN_MIRROR])).unbind(1)
        return seen, mirrored

    def _convolved(self, batch: GraphBatch, sides: Sequence[Sequence[float]]) -> Tensor:
        """Return mean ‖ max over each frame's points, of each of S sides: [B, S, 2 width]."""
        weight, bias, *later = self.layers.parameters()
        # A mirror changes but the sign of some node features, and in Â H W one may as well change that of W's rows.
        wide = torch.cat([weight * weight.new_tensor(signs)[:, None] for signs in sides], dim=1)
        return convolved(batch, self.semantics, len(sides), [wide, bias.repeat(len(sides)), *later])


SEEN = (1.0,) * NODE_FEATURES


def _layer_by_layer(batch: GraphBatch) -> bool:
    kind = batch.xyz.device.type
    return kind != "cpu" or torch.is_autocast_enabled(kind)


network = GCN
