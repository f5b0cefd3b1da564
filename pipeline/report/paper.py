"""List the networks of the paper's claims, with settings (Table 1) and errors (Table 2).

A model is compared with the paper if it has the name and the settings of such a network, and if the
graph variant of its input has the settings that the claims need.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Network(NamedTuple):
    """A network, with the settings of a model that the paper gives, and its MSE."""

    input: str
    spatial: str
    temporal: str
    window: int
    semantics: float  # λ of eq. 7
    train_mse: float | None = None
    test_mse: float | None = None


class Input(NamedTuple):
    """A graph variant, with the settings that the paper's claims need."""

    source: str
    has_edges: bool = False
    is_pruned: bool = False  # between classes


# Name of a network's input → its variant.
INPUTS = {
    "image": Input("ingest"),
    "lidar": Input("clouds/lidar", has_edges=True),
    "lidar-50k": Input("clouds/lidar", has_edges=True),
    "lidar-pointnet2": Input("clouds/lidar"),
    "depth": Input("clouds/pseudo", has_edges=True),
    "semantic": Input("clouds/pseudo", has_edges=True, is_pruned=True),
}
# Name of a model → network, in the order of the paper's Table 2. The last two are not in the paper:
# sa-gnn-ncp with all edges (variant depth is semantic without pruning), and with λ = 0.
NETWORKS = {
    "cnn-ncp": Network("image", "cnn", "ncp", 16, 0, 0.108, 0.2676),
    "gnn-lstm": Network("lidar-50k", "gnn", "lstm", 8, 0, 0.033, 0.130),
    "gnn-ncp": Network("lidar", "gnn", "ncp", 8, 0, 0.046, 0.132),
    "pointnet2-lstm": Network("lidar-pointnet2", "pointnet2", "lstm", 6, 0, 0.032, 0.182),
    "pointnet2-ncp": Network("lidar-pointnet2", "pointnet2", "ncp", 6, 0, 0.053, 0.240),
    "do-gnn-ncp": Network("depth", "gnn", "ncp", 8, 0, 0.038, 0.081),
    "sa-gnn-ncp": Network("semantic", "gnn", "ncp", 8, 1, 0.037, 0.0771),
    "keep-100": Network("depth", "gnn", "ncp", 8, 1),
    "lambda-0": Network("semantic", "gnn", "ncp", 8, 0),
}
# Settings that all networks have. Settings that are not listed may differ, since the paper
# gives no learning rates and not all widths. It prints its NCP as eq. 4 but cites the paper of the
# LTC cell, so an NCP may have either cell.
_COMMON = {
    "equivariant": False,
    "motion": "none",
    "horizon": 0,
    "predict": "angle",
}


class Claim(NamedTuple):
    """A claim of the paper that a model has a smaller error than its rival."""

    text: str
    model: str
    rival: str
    comparable: bool = False  # the claim is that both errors are equally large


# Claims of the paper. A claim has a verdict if the values have both of its networks.
CLAIMS = (
    Claim("3D from images is better than images alone", "sa-gnn-ncp", "cnn-ncp"),
    Claim("graph networks are better than PointNet++", "gnn-ncp", "pointnet2-ncp"),
    Claim("depth from images is at least as good as LiDAR", "do-gnn-ncp", "gnn-ncp"),
    Claim("classes with pruning help", "sa-gnn-ncp", "do-gnn-ncp"),
    Claim("… classes, where both prune", "sa-gnn-ncp", "lambda-0"),
    Claim("… pruning, where both have classes", "sa-gnn-ncp", "keep-100"),
    Claim("NCP and LSTM are comparable", "gnn-ncp", "gnn-lstm", comparable=True),
)


def is_network(name: str, entry: Mapping[str, Any], variant: Mapping[str, Any]) -> bool:
    """Return whether a model has the name and the settings of one of NETWORKS.

    `entry` holds the model's settings, and `variant` those of its input. The width of a network
    with PointNet++ may differ.
    """
    network = NETWORKS.get(name)
    if network is None or not _is_input(network.input, variant):
        return False
    # The first five fields are settings. Settings that a model lacks are not compared. Only the
    # paper's CNN weights frames (alpha).
    expected = _COMMON | dict(list(network._asdict().items())[:5])
    if network.spatial != "cnn":
        expected["alpha"] = 0
    if network.spatial != "pointnet2":
        expected["width"] = 1.0
    return all(entry.get(key, value) == value for key, value in expected.items())


def _is_input(name: str, variant: Mapping[str, Any]) -> bool:
    """Return whether a graph variant has the settings of one of INPUTS.

    `variant` lacks keys that have their defaults. Edges of points that the paper's network does not
    read may differ.
    """
    expected = INPUTS[name]
    if variant.get("source") != expected.source:
        return False
    if not expected.has_edges:
        return True
    is_pruned = variant.get("keep_inter_class", 1.0) < 1
    return variant.get("k", 0) > 0 and is_pruned == expected.is_pruned


def mse_ratio(claim: Claim) -> float | None:
    """Return the ratio of the test MSE of a claim's networks in the paper, if it has both."""
    model_mse = NETWORKS[claim.model].test_mse
    rival_mse = NETWORKS[claim.rival].test_mse
    return model_mse / rival_mse if model_mse and rival_mse else None
