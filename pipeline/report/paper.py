"""The paper's seven networks, with their settings (Table 1) and errors (Table 2), and its claims
about them.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pipeline.graphs.settings import Variant


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
    """Return the paper's network of a model's name, but for PointNet++'s width.

    None without one, or if the model has other settings.
    """
    network = PAPER.get(name)
    if network is None or variant.get("accumulate"):
        return None
    expected = _COMMON | dict(zip(network._fields[:5], network, strict=False))
    if network.spatial != "cnn":
        expected["alpha"] = 0
    if network.spatial != "pointnet2":
        expected["width"] = 1.0
    for key, value in expected.items():
        if entry.get(key, value) != value:
            return None
    return network


def claims(models: Mapping[str, Mapping[str, Any]]) -> list[Claim]:
    """Return the claims that models can judge: name → metrics.json with its network, `paper`.

    Rivals that are not the paper's differ from the claim's model in one setting.
    """
    judged = []
    for claim in CLAIMS:
        model = models.get(claim.model)
        rival = models.get(claim.rival)
        if model and rival and model["paper"]:
            control = claim.rival not in PAPER and _differing(model, rival) == 1
            if rival["paper"] or control:
                judged.append(claim)
    return judged


def _differing(first: Mapping[str, Any], second: Mapping[str, Any]) -> int:
    """Return the number of settings, of models or of their graphs, in which two models differ."""
    entries = first["entry"], second["entry"]
    names = entries[0].keys() & entries[1].keys() - {"input"}
    count = sum(entries[0][name] != entries[1][name] for name in names)
    for name, field in Variant.model_fields.items():
        values = [row["variant"].get(name, field.default) for row in (first, second)]
        count += values[0] != values[1]
    return count
