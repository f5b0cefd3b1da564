"""Networks in plain tensors say what the networks themselves say."""

from functools import partial

import pytest
import torch
from torch import Tensor, nn

from models.steering.core.batch import GraphBatch
from models.steering.core.graph_network import GraphNetwork
from models.steering.core.knobs import Sizes
from models.steering.core.steering_net import SteeringNet
from models.steering.spatial import blind, edgeconv, gatv2, gnn
from models.steering.temporal.lstm import LSTM
from pipeline.live.export.plain import Edges, Recurrent, Spatial, convolved, seen

POINTS = 50
NETWORKS = [
    gnn.GCN(6, gnn.Knobs(layers=(32, 8), semantics=1.0)),  # wider than its input, then narrower
    gnn.GCN(6, gnn.Knobs(layers=(16,))),
    edgeconv.Knobs(layers=(16, 8), semantics=0.5).build(Sizes(6)),
    gatv2.Knobs(layers=(16, 6), semantics=1.0).build(Sizes(6)),  # four heads, and two
    blind.Blind(6),
]


def frame(lonely: int = 5) -> GraphBatch:
    """A frame whose first and last points have no neighbours, nor have some between."""
    torch.manual_seed(0)
    joined = torch.rand(POINTS, POINTS) < 0.1
    joined = (joined | joined.T).fill_diagonal_(False)
    alone = torch.cat([torch.tensor([0, 1, POINTS - 1]), torch.randperm(POINTS)[: lonely - 3]])
    joined[alone], joined[:, alone] = False, False
    xyz, trainid = 20 * torch.randn(POINTS, 3), torch.randint(0, 19, (POINTS,), dtype=torch.uint8)
    indices = joined.nonzero()[:, 1].int()
    return GraphBatch(xyz, trainid, torch.tensor([0, POINTS]), joined.sum(1).to(torch.uint8), indices)


@pytest.mark.parametrize("network", NETWORKS, ids=lambda network: type(network).__name__)
@pytest.mark.parametrize("equivariant", [False, True])
def test_a_frame_is_seen_as_the_network_sees_it(network: nn.Module, equivariant: bool) -> None:
    net = SteeringNet(network, LSTM(6), equivariant)
    with torch.no_grad():
        torch.testing.assert_close(Spatial(net).of_frame(frame()), net.encode(frame()), rtol=0, atol=2e-6)


def test_every_edge_belongs_to_the_node_in_whose_list_it_stands() -> None:
    batch = frame()
    edges = Edges(batch.degree, batch.indices)
    own = torch.arange(POINTS).repeat_interleave(batch.degree.long())
    assert edges.node.tolist() == own.tolist()
    rows = torch.randn(len(own), 3)
    of_node = [rows[own == node] for node in range(POINTS)]
    torch.testing.assert_close(edges.sums(rows), torch.stack([part.sum(0) for part in of_node]))
    assert edges.maxima(rows)[batch.degree == 0].eq(-torch.inf).all()
    torch.testing.assert_close(edges.maxima(rows)[2], of_node[2].amax(0))


@pytest.mark.parametrize(("equivariant", "motion"), [(False, False), (True, True)])
def test_a_window_is_heard_as_the_network_hears_it(equivariant: bool, motion: bool) -> None:
    torch.manual_seed(0)
    net = SteeringNet(nn.Identity(), LSTM(6 + 4 * motion), equivariant, motion)
    features, dt_s, moved = torch.randn(1, 4, 6), torch.full((1, 4), 0.1), torch.randn(1, 4, 4)
    given = (moved,) if motion else ()
    expected = net.recall(features[0], torch.arange(4)[None], dt_s, *(each[0] for each in given))
    torch.testing.assert_close(Recurrent(net, 4)(features, dt_s, *given), expected)


class Unknown(nn.Linear):
    @staticmethod
    def operator(batch: GraphBatch, dtype: torch.dtype) -> None:
        return None

    def forward(self, x: Tensor, operator: None = None) -> Tensor:
        return super().forward(x)


def test_a_layer_without_a_plain_form_says_so() -> None:
    network = partial(GraphNetwork, Unknown)(6)
    with pytest.raises(ValueError, match=r"Unknown has no plain form in pipeline/live/export/plain\.py"):
        seen(network, frame())
    assert isinstance(
        convolved(gnn.GCNLayer(2, 3), torch.randn(POINTS, 2), Edges(frame().degree, frame().indices)), Tensor
    )
