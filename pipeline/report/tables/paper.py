"""What the paper's Tables 1 and 2 say of its seven networks, and which models of params.yaml are theirs."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Published(NamedTuple):
    """A network of the paper: the settings of a model that it states (a tuple: any of them), its MSE in Table 2."""

    settings: Mapping[str, Any]
    train_mse: float
    test_mse: float


# Nothing of ours: no symmetry, no narrower PointNet++. The paper prints its NCP as eq. 4 and cites one of LTC cells.
_PLAIN = {"equivariant": False, "cell": ("ltc", "eq4"), "width": 1.0, "semantics": 0.0}
_EVEN = {**_PLAIN, "alpha": 0.0}  # each frame counts alike; of the CNN's loss, it states no weights
_SETS = {**_EVEN, "input": "lidar-pointnet2", "spatial": "pointnet2", "window": 6}
_GRAPHS = {**_EVEN, "spatial": "gnn", "window": 8}
PAPER = {  # in its order
    "cnn-ncp": Published(
        {**_PLAIN, "input": "image", "spatial": "cnn", "temporal": "ncp", "window": 16}, 0.108, 0.2676
    ),
    "gnn-lstm": Published({**_GRAPHS, "input": "lidar-50k", "temporal": "lstm"}, 0.033, 0.130),
    "gnn-ncp": Published({**_GRAPHS, "input": "lidar", "temporal": "ncp"}, 0.046, 0.132),
    "pointnet2-lstm": Published({**_SETS, "temporal": "lstm"}, 0.032, 0.182),
    "pointnet2-ncp": Published({**_SETS, "temporal": "ncp"}, 0.053, 0.240),
    "do-gnn-ncp": Published({**_GRAPHS, "input": "depth", "temporal": "ncp"}, 0.038, 0.081),
    "sa-gnn-ncp": Published({**_GRAPHS, "input": "semantic", "temporal": "ncp", "semantics": 1.0}, 0.037, 0.0771),
}


def name(settings: Mapping[str, Any]) -> str | None:
    """Return which network of the paper a model's settings describe, whatever its own name; None if it is ours."""
    for network, published in PAPER.items():
        if all(_agrees(settings.get(key), stated) for key, stated in published.settings.items()):
            return network
    return None


def _agrees(value: Any, stated: Any) -> bool:
    """Whether a model's setting is what the paper states. One that a model lacks means nothing to it."""
    return value is None or value in (stated if isinstance(stated, tuple) else (stated,))
