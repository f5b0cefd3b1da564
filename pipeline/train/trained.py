"""Predict steering with a trained network; docs/models.md has an example."""

from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
import torch

from models.steering.core.steering_net import SteeringNet
from pipeline.base import checkpoint
from pipeline.base.earlier import LAST
from pipeline.base.errors import InputError, error_context
from pipeline.graphs.graph_file import Contents, Graphs, open_graphs
from pipeline.labels import label
from pipeline.train import windows
from pipeline.train.entry import Entry
from pipeline.train.frames import Files
from pipeline.train.loss import Scale
from pipeline.train.targets import Timeline

KIND = "steering net"  # of checkpoint
# Removed settings of entries, and their defaults. Networks with other values belong to closed
# questions.
REMOVED = {"fit_to": "train", "train_drives": None}
WINDOWS = 96  # per batch of predictions; limits the memory


class Trained(NamedTuple):
    """A trained network with everything needed to use it."""

    name: str
    seeds: list[int]  # of all networks of the model
    entry: Entry
    contents: Contents  # of the graph files it was trained on
    scale: Scale
    # section → settings that made graphs and labels of its training drives
    settings: dict[str, Any]
    drives: list[str]  # of training
    datasets: list[str]  # of the training drives; []: unknown
    fps: float  # their frame rate
    net: SteeringNet

    @property
    def car(self) -> label.Car:
        section = self.settings["labels"]
        return label.Car(section["wheelbase_m"], section["min_speed_mps"])

    @property
    def ahead_m(self) -> tuple[float, ...]:
        """Edges of the ranges of the path ahead; none for an angle."""
        return tuple(self.settings["labels"]["ahead_m"]) if self.entry.predict == "path" else ()

    def predict(
        self, graphs: Graphs, scene: Path | None = None, files: Files | None = None
    ) -> np.ndarray:
        """Return the predictions for the G frames of a file, float64 [G,R], in the columns
        `scale.names`.

        The value for frame t is the angle at frame t + `entry.horizon`, predicted from the frames
        up to t, or the path ahead of it. NaN where no complete window ends: too early in the drive,
        or too soon after a gap. `scene`: the graph file of the drive whose scene a control with
        `scene: another` gets; `files`: open ones. Raises InputError if the file has another kind of
        frames than the network was trained on, or no motion.
        """
        if scene is None and self.entry.scene == "another":
            problem = f"model {self.name} is a control, which needs the scene of another drive"
            raise InputError(problem, graphs.path, "Choose a model with scene: same")
        timeline = replace(Timeline.read(graphs, self.car, self.entry), scene=scene or graphs.path)
        with open_graphs(timeline.scene) as seen:
            if seen.contents != self.contents:
                problem = f"model {self.name} expects {self.contents}, got {seen.contents}"
                fix = f"Use graphs of input: {self.entry.input}, or train the model again"
                raise InputError(problem, seen.path, fix)
        return predict_drives(
            self.net, windows.Reader([timeline], self.entry.window, files), self.scale
        )[0]


def load(folder: str | Path, device: torch.device | str | None = None) -> Trained:
    """Load best.pt of a trained model: data/train/<model>, or a folder seed-<n> in it.

    `device` None: a GPU if there is one. Raises InputError if there is none, or if this code cannot
    rebuild it.
    """
    path = Path(folder) / "best.pt"
    if not path.is_file():
        models = sorted(
            str(best.parent)
            for at in (path.parent, path.parent.parent)
            for best in at.glob("*/best.pt")
        )
        fix = (
            f"Trained models near it: {', '.join(models) or 'none'}. To train one: dvc repro "
            "train@MODEL"
        )
        raise InputError("no trained model, best.pt is missing", folder, fix)
    with error_context(fix="Train it again: dvc repro --force --single-item train@MODEL"):
        content = checkpoint.read(path, KIND)
        try:
            entry, contents = read_entry(content["entry"], path), Contents(**content["contents"])
            scale = Scale.parse(content["scale"])
            about = {key: content[key] for key in ("name", "seeds", "settings", "drives", "fps")}
            about["datasets"] = content.get("datasets", [])
            # of earlier versions
            height_m = about["settings"].get("perception", {}).pop("camera_height_m", None)
            about["settings"].setdefault("camera_height_m", height_m)
        except InputError:
            raise
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"not a model of this version ({shorten(repr(error), 200)})", path
            ) from error
        net = entry.build(**contents._asdict(), outputs=len(scale.names))
        checkpoint.load_state(net, content["net"], path)
    net.to(device or ("cuda" if torch.cuda.is_available() else "cpu")).eval()
    return Trained(**about, entry=entry, contents=contents, scale=scale, net=net)


def read_entry(content: dict[str, Any], path: Path) -> Entry:
    """Return the entry of a checkpoint, which may be of an earlier revision. Raises InputError."""
    settings = dict(content)
    for key, default in REMOVED.items():
        value = settings.pop(key, default)
        if value != default:
            raise InputError(
                f"was trained by revision {LAST} with {key}: {value}", path, "Use that revision"
            )
    return Entry.model_validate(settings)


def predict_drives(net: SteeringNet, reader: windows.Reader, scale: Scale) -> list[np.ndarray]:
    """Return the predictions [G,R] for the frames of each of the reader's timelines."""
    spans = windows.spans(reader.timelines, reader.window, WINDOWS)
    net.eval()
    with torch.inference_mode():
        outputs = [
            net(*net.inputs(batch))
            for batch in reader.batches([[span] for span in spans], net.device)
        ]
    values = [
        np.full((len(timeline.frame), len(scale.names)), np.nan) for timeline in reader.timelines
    ]
    # after the loop, so that it does not wait for the GPU
    for span, output in zip(spans, outputs, strict=True):
        values[span.drive][span.stop - len(output) : span.stop] = output.double().cpu().numpy()
    pairs = zip(values, reader.timelines, strict=True)
    return [scale.decode(output, timeline.base) for output, timeline in pairs]
