import pytest
import torch

from models.steering.core.batch import GraphBatch
from models.steering.core.graph_network import GraphNetwork, GraphOptions
from models.steering.spatial.edgeconv import EdgeConvLayer
from models.steering.spatial.gatv2 import GATv2Layer
from models.steering.spatial.gnn import GCNLayer

TOLERANCE = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(params=[(GCNLayer, 0), (EdgeConvLayer, 0), (GATv2Layer, 0), (GCNLayer, 5)])
def network(request):
    torch.manual_seed(0)
    layer, sectors = request.param
    return GraphNetwork(layer, 5, GraphOptions(layers=(8, 16), semantics=1.0, sectors=sectors)).double()


def one_frame(batch: GraphBatch, frame: int) -> GraphBatch:
    start, end = batch.ptr[frame : frame + 2].tolist()
    edges = batch.degree.long()
    first, last = edges[:start].sum(), edges[:end].sum()
    rows = slice(start, end)
    indices = batch.indices[first:last] - start
    return GraphBatch(batch.xyz[rows], batch.cls[rows], torch.tensor([0, end - start]), batch.degree[rows], indices)


def test_order_of_points_changes_nothing(make_batch, network):
    batch = make_batch([40])
    order = torch.randperm(40)
    place = order.argsort()
    neighbours = batch.indices.split(batch.degree.tolist())
    shuffled = GraphBatch(
        batch.xyz[order],
        batch.cls[order],
        batch.ptr,
        batch.degree[order],
        torch.cat([place[neighbours[node]] for node in order]),
    )
    torch.testing.assert_close(network(shuffled), network(batch), **TOLERANCE)


@pytest.mark.parametrize("counts", [[12, 12, 12], [30, 0, 1, 17]])
def test_batch_equals_single_frames(make_batch, network, counts):
    batch = make_batch(counts)
    singles = torch.cat([network(one_frame(batch, frame)) for frame in range(batch.frames)])
    torch.testing.assert_close(network(batch), singles, **TOLERANCE)


def test_sectors_are_zero_or_odd():
    with pytest.raises(ValueError, match="expected 0 or an odd number"):
        GraphOptions(sectors=8)
