"""The paper's seven networks, with their settings (Table 1) and errors (Table 2), and its claims
about them.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Published(NamedTuple):
    """A network of the paper: what it gives of a model's settings, and its MSE."""

    input: str
    spatial: str
    temporal: str
    window: int
    semantics: float
    train_mse: float
    test_mse: float


PAPER = {  # in the order of Table 2
    "cnn-ncp": Published("image", "cnn", "ncp", 16, 0, 0.108, 0.2676),
    "gnn-lstm": Published("lidar-50k", "gnn", "lstm", 8, 0, 0.033, 0.130),
    "gnn-ncp": Published("lidar", "gnn", "ncp", 8, 0, 0.046, 0.132),
    "pointnet2-lstm": Published("lidar-pointnet2", "pointnet2", "lstm", 6, 0, 0.032, 0.182),
    "pointnet2-ncp": Published("lidar-pointnet2", "pointnet2", "ncp", 6, 0, 0.053, 0.240),
    "do-gnn-ncp": Published("depth", "gnn", "ncp", 8, 0, 0.038, 0.081),
    "sa-gnn-ncp": Published("semantic", "gnn", "ncp", 8, 1, 0.037, 0.0771),
}
# Settings of all seven, compared where a model has them. The paper gives no learning rates and no
# other widths. It prints its NCP as eq. 4 and cites the paper of the LTC cell, so both count. Only
# the CNN weights frames (alpha).
_COMMON = {
    "equivariant": False,
    "motion": "none",
    "horizon": 0,
    "predict": "angle",
    "scene": "same",
    "width": 1.0,
}


class Claim(NamedTuple):
    """A claim of the paper about two models: the first has a smaller error, or, if `comparable`,
    one as large.
    """

    text: str
    model: str
    rival: str
    comparable: bool = False


# keep-100: sa-gnn-ncp with all edges; lambda-0: with λ = 0 in eq. 7.
CLAIMS = (
    Claim("3D from images is better than images alone", "sa-gnn-ncp", "cnn-ncp"),
    Claim("graph networks are better than PointNet++", "gnn-ncp", "pointnet2-ncp"),
    Claim("depth from images is at least as good as LiDAR", "do-gnn-ncp", "gnn-ncp"),
    Claim("classes with pruning help", "sa-gnn-ncp", "do-gnn-ncp"),
    Claim("… classes alone", "sa-gnn-ncp", "lambda-0"),
    Claim("… pruning alone", "sa-gnn-ncp", "keep-100"),
    Claim("NCP and LSTM are comparable", "gnn-ncp", "gnn-lstm", comparable=True),
)


def find(name: str, entry: Mapping[str, Any], variant: Mapping[str, Any]) -> Published | None:
    """Return the paper's network of a model's name, None without one or if the model has other
    settings.
    """
    if (network := PAPER.get(name)) is None or variant.get("accumulate"):
        return None
    expected = _COMMON | dict(zip(network._fields[:5], network, strict=False))
    expected |= {} if network.spatial == "cnn" else {"alpha": 0}
    return (
        network if all(entry.get(key, value) == value for key, value in expected.items()) else None
    )
