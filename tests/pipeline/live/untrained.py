"""An untrained small model, and graph files for it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pipeline.graphs import graph_file
from pipeline.settings.models import Entry
from pipeline.train import checkpoint, predict
from pipeline.train.labelled_drive import column_names
from pipeline.train.predict import Trained
from pipeline.train.scale import Scale
from tests import artefacts

DRIVES = {"2026_01_01_drive_0001": "train", "2026_01_03_drive_0001": "test"}
WRITERS = {"pointnet2": artefacts.write_sets, "cnn": artefacts.write_images}
SMALL: dict[str, dict[str, Any]] = {"pointnet2": {"width": 0.125}, "cnn": {}, "blind": {}, "polar": {"widths": [4, 8]}}
WINDOW = 3
EDGES_M = (0, 2, 4)
WAVE = 0.1 * torch.linspace(0, 6, 12).sin().numpy()


def model(folder: Path, spatial: str = "gnn", temporal: str = "lstm", **settings: Any) -> Trained:
    """Write drives to folder/graphs/semantic and folder/labels, and return an untrained model of them."""
    write: Callable[..., None] = WRITERS.get(spatial, artefacts.write_graphs)
    artefacts.write_dataset(folder, DRIVES, frames=12, points=40, write=write, ahead_m=EDGES_M)
    for drive in DRIVES:
        artefacts.add_motion(folder / f"graphs/semantic/{drive}.h5", WAVE)
    line = {"input": "semantic", "spatial": spatial, "temporal": temporal, "window": WINDOW, "features": 8}
    line |= {"equivariant": False, "motion": "none", "horizon": 0, "learning_rate": None, "alpha": 0.0}
    line |= {"fit_to": "train", "roads": None}
    line |= SMALL.get(spatial, {"layers": [16, 8], "semantics": 1.0}) | settings
    with graph_file.open_graphs(folder / f"graphs/semantic/{next(iter(DRIVES))}.h5") as graphs:
        contents = graphs.contents
    torch.manual_seed(0)
    entry = Entry.model_validate(line)
    scale = Scale(["steering_rad"], np.ones(1), np.array([0.1]), np.zeros(1))
    if entry.predict == "path":
        scale = Scale(column_names(EDGES_M), np.array([0.9, 0.5]), np.array([0.01, 0.01]), np.zeros(2))
    net = entry.build(**contents.model_dump(), outputs=len(scale.names)).eval()
    settings = artefacts.LABELS["labels"] | {"ahead_m": list(EDGES_M)}
    card = predict.Card(list(DRIVES), 10.0)
    return Trained("net", 0, [0], None, entry, contents, scale, {"labels": settings}, card, net)


def save(trained: Trained, folder: Path) -> Path:
    """Write the model as training does, and return its folder."""
    about = {name: getattr(trained, name) for name in ("name", "seed", "seeds", "fold", "settings")}
    about |= {"contents": trained.contents.model_dump(), "card": trained.card._asdict()}
    about |= {"entry": trained.entry.model_dump(mode="json"), "scale": trained.scale.content}
    checkpoint.write(
        folder / trained.name / "best.pt", {**about, "net": trained.net.state_dict(), "kind": predict.KIND}
    )
    return folder / trained.name
