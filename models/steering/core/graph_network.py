"""A frame's graph in, a few numbers out: node features → graph layers → pooling → read-out."""

import torch
from torch import Tensor, nn

from models.steering.core.batch import CLASSES, GEOMETRY, GraphBatch, mean_max_pool, node_features


class GraphNetwork(nn.Module):
    """The spatial network on point graphs; which convolution it stacks is a constructor.

    Args:
        layer: class with `layer(inputs, outputs)`, a static `operator(batch, dtype)`, computed once per batch for all
            layers, and `forward(x [N, inputs], operator) -> [N, outputs]`.
        widths: channels after each layer.
        features: numbers per frame that go to the recurrent network.
        semantics: λ of paper eq. 7, in [0,1].
    Raises:
        ValueError: semantics out of range.
    """

    def __init__(self, layer: type[nn.Module], widths: list[int], features: int, semantics: float) -> None:
        super().__init__()
        if not 0 <= semantics <= 1:
            raise ValueError(
                f"semantics = {semantics} is out of range: it weights the classes, from 0 (depth only) to 1"
            )
        self.semantics = semantics
        self.layers = nn.ModuleList(
            layer(inputs, outputs) for inputs, outputs in zip([GEOMETRY + CLASSES, *widths[:-1]], widths, strict=True)
        )
        self.read_out = nn.Linear(2 * widths[-1], features)

    def forward(self, batch: GraphBatch) -> Tensor:
        """Return [B, features]; neither the order of points nor other frames in the batch change a frame's numbers."""
        dtype = self.read_out.weight.dtype
        operator = self.layers[0].operator(batch, dtype)  # type: ignore[operator]
        x = node_features(batch.xyz.to(dtype), batch.cls, self.semantics)  # [N, 25]
        for layer in self.layers:
            x = layer(x, operator).relu()  # [N, width]
        pooled = mean_max_pool(x, batch.ptr)  # [B, 2 width]
        return torch.tanh(self.read_out(pooled))  # [B, features]; the range that LTC synapses listen to
