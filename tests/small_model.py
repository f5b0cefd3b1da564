"""A small model on small graphs: its params.yaml, and the stages train and evaluate; and a network
of a user.
"""

from pathlib import Path
from typing import ClassVar

import pytest
import yaml
from torch import Tensor, nn

from models.steering.core import options
from models.steering.core.batch import FrameKind, GraphBatch
from models.steering.core.features import NODE_FEATURES, mean_max_pool, node_features
from models.steering.core.options import NetworkOptions, Sizes
from pipeline.train.entry import Entry
from stages import evaluate, train

PARAMS = Path(__file__).resolve().parents[1] / "params.yaml"
SPLITS = {
    "2026_01_01_drive_0001": "train",
    "2026_01_01_drive_0002": "train",
    "2026_01_01_drive_0003": "train",
    "2026_01_02_drive_0001": "val",
    "2026_01_03_drive_0001": "test",
}
TEST, EDGES_M = "2026_01_03_drive_0001", [0, 5, 10, 20]


class UsersNetwork(nn.Sequential):
    def forward(self, batch: GraphBatch) -> Tensor:
        return super().forward(mean_max_pool(node_features(batch.xyz, batch.cls, 1.0), batch.ptr))


class UsersOptions(NetworkOptions):
    kind: ClassVar[FrameKind] = "graph"

    def build(self, sizes: Sizes) -> nn.Module:
        inputs = 2 * NODE_FEATURES
        return UsersNetwork(
            nn.BatchNorm1d(inputs), nn.Dropout(), nn.Linear(inputs, sizes.features), nn.Tanh()
        )


def add_users_network(patch: pytest.MonkeyPatch) -> None:
    """Add `spatial: users`, as a file users.py would."""
    load_options = options.load_options
    patch.setattr(
        options,
        "load_options",
        lambda part, name: UsersOptions if name == "users" else load_options(part, name),
    )


def write_params(folder: Path, model: dict[str, object] | None = None, **settings: object) -> None:
    """Write params.yaml with the model `net`, whose entry is changed by `model`, and section train
    by `settings`.
    """
    content = yaml.safe_load(PARAMS.read_text())
    entry = {
        "input": "semantic",
        "spatial": "gnn",
        "temporal": "ncp",
        "window": 4,
        "features": 8,
        "equivariant": True,
    }
    entry |= model or {}
    options = {"cnn": {}, "pointnet2": {"semantics": 1.0}, "polar": {}, "users": {}}.get(
        str(entry["spatial"]), {"layers": [16, 16], "semantics": 1.0}
    )
    content["models"] = {"net": options | entry}
    content["train"] |= {"epochs": 3, "learning_rate": 0.01, **settings}
    (folder / "params.yaml").write_text(yaml.safe_dump(content))


def entry(**changes: object) -> Entry:
    return Entry.model_validate(
        {"input": "semantic", "spatial": "polar", "temporal": "ncp"} | changes
    )


def run_train(folder: Path) -> Path:
    return train.main("net", folder, folder / "train", folder / "params.yaml")


def run_evaluate(folder: Path) -> Path:
    return evaluate.main("net", folder, folder / "params.yaml")
