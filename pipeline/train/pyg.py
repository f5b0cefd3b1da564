"""Cached graphs for PyTorch Geometric, which is installed with '.[dev]'."""

from typing import TYPE_CHECKING

import numpy as np

from pipeline.graphs.graph_file import Graphs

if TYPE_CHECKING:
    from torch_geometric.data import Data


def to_pyg(graphs: Graphs, number: int, steering_rad: float = np.nan) -> "Data":
    """Return the graph of frame `number` of an open file.

    pos [N,3] in metres, x [N,25] node features with λ = 1, edge_index [2,E], both directions of each edge, and y [1],
    the angle. Raises InputError if the file has no such frame or holds no kNN graphs.
    """
    import torch
    from torch_geometric.data import Data

    from models.steering.core.features import node_features

    xyz, cls, edges = (torch.from_numpy(array) for array in graphs.graph(graphs.row_of(number)))
    edges = torch.cat([edges, edges.flip(1)]).T.contiguous()
    y = torch.tensor([steering_rad], dtype=torch.float32)
    return Data(pos=xyz, x=node_features(xyz, cls, semantics=1.0), edge_index=edges, y=y)
