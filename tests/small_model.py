"""A small model on small graphs: its params.yaml, stages train and evaluate, a user's network."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from torch import Tensor, nn

from models.steering.core import options
from models.steering.core.batch import FrameKind, GraphBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Sizes
from pipeline.train.entry import Entry
from pipeline.train.targets import LabelledDrive, read_drive
from stages import evaluate, train

PARAMS = Path(__file__).resolve().parents[1] / "params.yaml"
SPLITS = {
    "2026_01_01_drive_0001": "train",
    "2026_01_01_drive_0002": "train",
    "2026_01_01_drive_0003": "train",
    "2026_01_02_drive_0001": "val",
    "2026_01_03_drive_0001": "test",
}
TEST = "2026_01_03_drive_0001"
MODEL = {"input": "semantic", "spatial": "gnn", "temporal": "ncp"}
# Edges of the ranges of the path ahead.
EDGES_M = [0, 5, 10, 20]
# Options of the spatial networks that do not have the layers of a graph network.
OPTIONS: dict[str, dict[str, object]] = {
    "cnn": {},
    "pointnet2": {"semantics": 1.0},
    "users": {},
    "surface": {"semantics": 1.0},
}


class UsersNetwork(nn.Sequential):
    def forward(self, batch: GraphBatch) -> Tensor:
        points = node_features(batch.xyz, batch.cls, 1.0)
        return super().forward(mean_max_pool(points, batch.ptr))


class UsersOptions(NetworkOptions):
    kind: ClassVar[FrameKind] = "graph"

    def build(self, sizes: Sizes) -> nn.Module:
        inputs = 2 * NODE_FEATURES
        return UsersNetwork(
            nn.BatchNorm1d(inputs), nn.Dropout(), nn.Linear(inputs, sizes.features), nn.Tanh()
        )


def add_network(patch: pytest.MonkeyPatch, spatial: str, network: type[NetworkOptions]) -> None:
    """Add a spatial network, as a file of its name would."""
    load_options = options.load_options

    def load(part: Any, name: str) -> type[NetworkOptions]:
        return network if name == spatial else load_options(part, name)

    patch.setattr(options, "load_options", load)


def add_users_network(patch: pytest.MonkeyPatch) -> None:
    """Add `spatial: users`, as a file users.py would."""
    add_network(patch, "users", UsersOptions)


def write_params(folder: Path, model: dict[str, object] | None = None, **settings: object) -> None:
    """Write params.yaml with the model `net`.

    `model` changes its entry, `settings` section train.
    """
    content = yaml.safe_load(PARAMS.read_text())
    entry = MODEL | {"window": 4, "features": 8, "equivariant": True} | (model or {})
    layers = {"layers": [16, 16], "semantics": 1.0}
    content["models"] = {"net": OPTIONS.get(str(entry["spatial"]), layers) | entry}
    content["train"] |= {"epochs": 3, "learning_rate": 0.01, **settings}
    (folder / "params.yaml").write_text(yaml.safe_dump(content))


def entry(**changes: object) -> Entry:
    return Entry.model_validate(MODEL | {"semantics": 1.0} | changes)


def read_drives(folder: Path, names: Iterable[str], **changes: object) -> list[LabelledDrive]:
    """Read drives of :func:`tests.artefacts.write_dataset` for a model with `changes`."""
    model = entry(**changes)
    graphs = folder / "graphs/semantic"
    labels = folder / "labels"
    return [read_drive(graphs, labels, folder / "motion", name, model) for name in names]


def run_train(folder: Path) -> Path:
    return train.main("net", folder, params=folder / "params.yaml")


def run_evaluate(folder: Path) -> Path:
    return evaluate.main("net", folder, folder / "params.yaml")
