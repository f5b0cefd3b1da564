from pathlib import Path

import numpy as np
import pytest
import torch

from models.steering.core.batch import GraphBatch, from_arrays
from models.steering.core.features import node_features
from models.steering.spatial import gnn
from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import collate, open_graphs
from pipeline.train.pyg import to_pyg
from tests import artefacts


def test_the_graph_is_the_one_that_gcn_sees(tmp_path: Path) -> None:
    """PyTorch Geometric's propagation on it equals ours."""
    gcn = pytest.importorskip("torch_geometric.nn")
    for name, write in {"graph.h5": artefacts.write_graphs, "image.h5": artefacts.write_images}.items():
        write(tmp_path / name, "drive", np.zeros(5), np.arange(5), 50, np.random.default_rng(0))
    with open_graphs(tmp_path / "graph.h5") as graphs:
        data, batch = to_pyg(graphs, 3, 0.25), from_arrays(collate([(graphs, 3, 4)]))
        with pytest.raises(InputError, match="no frame 99"):
            to_pyg(graphs, 99)
    assert isinstance(batch, GraphBatch)
    assert data.y.tolist() == [0.25]
    assert torch.equal(data.pos, batch.xyz)
    assert data.validate()
    assert not data.is_directed()
    net = gnn.GCNLayer(25, 4)
    peer = gcn.GCNConv(25, 4)
    peer.lin.weight.data, peer.bias.data = net.weight.data.T, net.bias.data
    ours = net(node_features(batch.xyz, batch.cls, 1.0), gnn.GCNLayer.operator(batch, torch.float32))
    torch.testing.assert_close(peer(data.x, data.edge_index), ours, atol=1e-5, rtol=0)
    with open_graphs(tmp_path / "image.h5") as images, pytest.raises(InputError, match="expected kNN graphs"):
        to_pyg(images, 3)
