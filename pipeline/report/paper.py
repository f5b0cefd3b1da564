"""List the paper's claims and its seven networks, with settings (Table 1) and errors (Table 2).

A model is compared with the paper if it has the name and the settings of a network of the paper.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pipeline.graphs.settings import Variant


class Published(NamedTuple):
    """A network of the paper, with the settings of a model that the paper gives, and its MSE."""

    input: str
    spatial: str
    temporal: str
    window: int
    semantics: float
    train_mse: float
    test_mse: float


# Name of a model → network of the paper, in the order of its Table 2.
PAPER = {
    "cnn-ncp": Published("image", "cnn", "ncp", 16, 0, 0.108, 0.2676),
    "gnn-lstm": Published("lidar-50k", "gnn", "lstm", 8, 0, 0.033, 0.130),
    "gnn-ncp": Published("lidar", "gnn", "ncp", 8, 0, 0.046, 0.132),
    "pointnet2-lstm": Published("lidar-pointnet2", "pointnet2", "lstm", 6, 0, 0.032, 0.182),
    "pointnet2-ncp": Published("lidar-pointnet2", "pointnet2", "ncp", 6, 0, 0.053, 0.240),
    "do-gnn-ncp": Published("depth", "gnn", "ncp", 8, 0, 0.038, 0.081),
    "sa-gnn-ncp": Published("semantic", "gnn", "ncp", 8, 1, 0.037, 0.0771),
}
# Settings that all seven networks have. Settings that are not listed may differ, since the paper
# gives no learning rates and not all widths. It prints its NCP as eq. 4 but cites the paper of the
# LTC cell, so both cells count.
_COMMON = {
    "equivariant": False,
    "motion": "none",
    "horizon": 0,
    "predict": "angle",
    "scene": "same",
}


class Claim(NamedTuple):
    """A claim of the paper that a model has a smaller error than its rival."""

    text: str
    model: str
    rival: str
    comparable: bool = False  # the claim is that both errors are equally large


# Claims of the paper. The rivals lambda-0 and keep-100 are no networks of the paper, but sa-gnn-ncp
# with λ = 0 in eq. 7, and with all edges.
CLAIMS = (
    Claim("3D from images is better than images alone", "sa-gnn-ncp", "cnn-ncp"),
    Claim("graph networks are better than PointNet++", "gnn-ncp", "pointnet2-ncp"),
    Claim("depth from images is at least as good as LiDAR", "do-gnn-ncp", "gnn-ncp"),
    Claim("classes with pruning help", "sa-gnn-ncp", "do-gnn-ncp"),
    Claim("… classes, where both prune", "sa-gnn-ncp", "lambda-0"),
    Claim("… pruning, where both have classes", "sa-gnn-ncp", "keep-100"),
    Claim("NCP and LSTM are comparable", "gnn-ncp", "gnn-lstm", comparable=True),
)


def find(name: str, entry: Mapping[str, Any], variant: Mapping[str, Any]) -> Published | None:
    """Return the paper's network that has a model's name and settings, or None.

    `entry` holds the model's settings, and `variant` those of its input. The width of a network
    with PointNet++ may differ.
    """
    network = PAPER.get(name)
    if network is None or variant.get("accumulate"):
        return None
    # The first five fields are settings. Settings that a model lacks are not compared. Only the
    # paper's CNN weights frames (alpha).
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
    """Return the claims that `models` can judge, name → its row of the results.

    The claim's model must be the paper's network. Its rival must be, too, or differ from the model
    in a single setting if the paper has no network of the rival's name.
    """
    judged = []
    for claim in CLAIMS:
        model = models.get(claim.model)
        rival = models.get(claim.rival)
        if model and rival and model["paper"]:
            is_variation = claim.rival not in PAPER and _differing(model, rival) == 1
            if rival["paper"] or is_variation:
                judged.append(claim)
    return judged


def _differing(first: Mapping[str, Any], second: Mapping[str, Any]) -> int:
    """Return the number of settings in which two models or their inputs differ."""
    first_entry = first["entry"]
    second_entry = second["entry"]
    names = first_entry.keys() & second_entry.keys() - {"input"}
    count = sum(first_entry[name] != second_entry[name] for name in names)
    for name, field in Variant.model_fields.items():
        first_value = first["variant"].get(name, field.default)
        second_value = second["variant"].get(name, field.default)
        count += first_value != second_value
    return count
