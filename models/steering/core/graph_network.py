"""A frame's graph in, a few numbers out: node features → graph layers → pooling → read-out."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.knobs import Fraction, Widths


class GraphNetwork(nn.Module):
    """The spatial networks on point graphs, each with its own kind of layer.

    Args:
        layer: class with `layer(inputs, outputs)`, a static `operator(batch, dtype)`, computed once per batch for all
            layers, and `forward(x [N, inputs], operator) -> [N, outputs]`.
        features: numbers per frame that go to the recurrent network.
        layers: channels after each layer.
        semantics: λ of paper eq. 7, how much the classes count: from 0 (depth only) to 1.
    """

    def __init__(
        self, layer: type[nn.Module], features: int, *, layers: Widths = (32, 32, 64), semantics: Fraction = 0.0
    ) -> None:
        super().__init__()
        self.semantics = semantics
        self.layers = nn.ModuleList(
            layer(inputs, outputs) for inputs, outputs in zip([NODE_FEATURES, *layers[:-1]], layers, strict=True)
        )
        self.read_out = nn.Linear(2 * layers[-1], features)

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return [B, features]; neither the order of points nor other frames in the batch change a frame's numbers."""
        return self.told(self.pooled(batch))

    def pooled(self, batch: GraphBatch) -> Tensor:
        """Return mean ‖ max over each frame's points after the last layer: [B, 2 width]."""
        dtype = self.read_out.weight.dtype
        operator = self.layers[0].operator(batch, dtype)  # type: ignore[operator]
        x = node_features(batch.xyz.to(dtype), batch.cls, self.semantics)  # [N, 25]
        for layer in self.layers:
            x = layer(x, operator).relu()  # [N, width]
        return mean_max_pool(x, batch.ptr)

    def told(self, pooled: Tensor) -> Tensor:
        """What the recurrent network is told of a frame: [..., 2 width] → [..., features]."""
        return torch.tanh(self.read_out(pooled))  # the range that LTC synapses listen to
