"""What the paper's Tables 1 and 2 say of its seven networks, and which models of params.yaml are theirs."""

from collections.abc import Mapping
from typing import Any, NamedTuple

Settings = dict[str, tuple[Any, ...]]


class Published(NamedTuple):
    """A network of the paper: key of a model's settings → values that are the paper's; its MSE in Table 2.

    `accumulate` is a setting of the graph variant.
    """

    settings: Settings
    train_mse: float
    test_mse: float


# What the paper leaves open is not here: widths, learning rates, … It prints its NCP as eq. 4 and cites the paper of
# the LTC cell. None: the model has no such setting.
_ALL: Settings = {
    "equivariant": (False, None), "cell": ("ltc", "eq4", None), "motion": ("none", None), "horizon": (0, None),
    "fit_to": ("train", None), "roads": (None,), "accumulate": (None,),
}  # fmt: skip
_POINTS: Settings = {**_ALL, "semantics": (0.0, None), "alpha": (0.0, None)}  # all frames weigh alike, unlike the CNN's
_SETS: Settings = {
    **_POINTS, "input": ("lidar-pointnet2",), "spatial": ("pointnet2",), "window": (6,), "width": (1.0, None),
}  # fmt: skip
_GRAPHS: Settings = {**_POINTS, "spatial": ("gnn",), "window": (8,)}
_IMAGES: Settings = {**_ALL, "input": ("image",), "spatial": ("cnn",), "window": (16,)}
PAPER = {  # in its order
    "cnn-ncp": Published({**_IMAGES, "temporal": ("ncp",)}, 0.108, 0.2676),
    "gnn-lstm": Published({**_GRAPHS, "input": ("lidar-50k",), "temporal": ("lstm",)}, 0.033, 0.130),
    "gnn-ncp": Published({**_GRAPHS, "input": ("lidar",), "temporal": ("ncp",)}, 0.046, 0.132),
    "pointnet2-lstm": Published({**_SETS, "temporal": ("lstm",)}, 0.032, 0.182),
    "pointnet2-ncp": Published({**_SETS, "temporal": ("ncp",)}, 0.053, 0.240),
    "do-gnn-ncp": Published({**_GRAPHS, "input": ("depth",), "temporal": ("ncp",)}, 0.038, 0.081),
    "sa-gnn-ncp": Published(
        {**_GRAPHS, "input": ("semantic",), "temporal": ("ncp",), "semantics": (1.0,)}, 0.037, 0.0771
    ),
}


def name(settings: Mapping[str, Any]) -> str | None:
    """Return which network of the paper a model's settings describe, whatever its own name; None if it is ours.

    Beside the model's own, `accumulate` of its graph variant.
    """
    for network, published in PAPER.items():
        if all(settings.get(key) in values for key, values in published.settings.items()):
            return network
    return None
