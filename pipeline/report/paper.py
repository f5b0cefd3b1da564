"""The paper's seven networks, with their settings (Table 1) and errors (Table 2), and its claims about them."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

Settings = dict[str, tuple[Any, ...]]


class Published(NamedTuple):
    """A network of the paper: settings of a model and its graph variant as key → accepted values, and its MSE."""

    settings: Settings
    train_mse: float
    test_mse: float


# Settings that the paper does not give, for instance widths and learning rates, are not compared. It prints its NCP as
# eq. 4 and cites the paper of the LTC cell, so both count. A setting that a model lacks counts as the first value.
_ALL: Settings = {
    "equivariant": (False,), "cell": ("ltc", "eq4"), "motion": ("none",), "horizon": (0,), "predict": ("angle",),
    "fit_to": ("train",), "train_drives": (None,), "accumulate": (None,), "scene": ("same",),
}  # fmt: skip
_POINTS: Settings = {**_ALL, "semantics": (0.0,), "alpha": (0.0,)}  # equal frame weights, unlike the CNN
_SETS: Settings = {**_POINTS, "input": ("lidar-pointnet2",), "spatial": ("pointnet2",), "window": (6,), "width": (1.0,)}
_GRAPHS: Settings = {**_POINTS, "spatial": ("gnn",), "window": (8,)}
_IMAGES: Settings = {**_ALL, "input": ("image",), "spatial": ("cnn",), "window": (16,)}
PAPER = {  # in the order of Table 2
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


class Claim(NamedTuple):
    """A claim of the paper about two models: the first has a smaller error, or, if `comparable`, one as large."""

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


def matches(name: str, settings: Mapping[str, Any], ignored: Collection[str] = ()) -> bool:
    """Return whether settings of a model and its graph variant are those of network `name`, `ignored` ones aside."""
    expected = {key: values for key, values in PAPER[name].settings.items() if key not in ignored}
    return all(settings.get(key, values[0]) in values for key, values in expected.items())


def find(settings: Mapping[str, Any]) -> Published | None:
    """Return the paper's network with the settings of a model and its graph variant, None if there is none."""
    return next((PAPER[name] for name in PAPER if matches(name, settings)), None)
