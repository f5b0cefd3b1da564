"""A small model on small graphs: its params.yaml, and the stages train and evaluate."""

from pathlib import Path

import yaml

from pipeline.base import store
from pipeline.settings.models import Entry
from stages import evaluate, train

PARAMS = Path(__file__).resolve().parents[1] / "params.yaml"
SPLITS = {
    "2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_01_drive_0003": "train",
    "2026_01_02_drive_0001": "val", "2026_01_03_drive_0001": "test",
}  # fmt: skip
TEST, EDGES_M = "2026_01_03_drive_0001", [0, 5, 10, 20]


def write_params(folder: Path, model: dict[str, object] | None = None, **settings: object) -> None:
    """Write params.yaml with the model `net`, whose entry is changed by `model`, and section train by `settings`."""
    content = yaml.safe_load(PARAMS.read_text())
    entry = {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 4, "features": 8, "equivariant": True}
    entry |= model or {}
    options = {"cnn": {}, "pointnet2": {"semantics": 1.0}, "polar": {}}.get(
        str(entry["spatial"]), {"layers": [16, 16], "semantics": 1.0}
    )
    content["models"] = {"net": options | entry}
    content["train"] |= {"epochs": 3, "learning_rate": 0.01, **settings}
    (folder / "params.yaml").write_text(yaml.safe_dump(content))


def entry(**changes: object) -> Entry:
    return Entry.model_validate({"input": "semantic", "spatial": "polar", "temporal": "ncp"} | changes)


def run_train(folder: Path) -> Path:
    return train.main("net", folder / "graphs", folder / "labels", folder / "train", folder / "params.yaml")


def run_evaluate(folder: Path) -> Path:
    return evaluate.main(
        "net", folder / "train", folder / "graphs", folder / "labels", folder / "evaluate", folder / "params.yaml"
    )


def write_two_test_drives(folder: Path) -> list[str]:
    """Make two of the training drives test drives; return the test drives."""
    tested = ["2026_01_01_drive_0002", "2026_01_01_drive_0003"]
    splits = {**SPLITS, **dict.fromkeys(tested, "test")}
    del splits["2026_01_03_drive_0001"]
    store.write_index(folder / "graphs/semantic", splits)
    return tested
