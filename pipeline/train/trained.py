"""Predict steering with a trained network; docs/models.md has an example."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np
import torch

from models.steering.core.steering_net import SteeringNet
from pipeline.base import checkpoint
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError, error_context
from pipeline.base.hashes import file_hash
from pipeline.base.store import DriveReader
from pipeline.graphs.graph_file import Contents, Graphs
from pipeline.train import windows
from pipeline.train.entry import Entry
from pipeline.train.frames import Files
from pipeline.train.loss import Scale
from pipeline.train.quantity import Quantity, load_quantity
from pipeline.train.targets import Timeline

# Kind of the checkpoint of a trained network.
KIND = "steering net"
# Key of a file of a model that this version has removed → its only value that still works.
REMOVED: dict[str, Any] = {
    "levels": 0,
    "neighbourhood": "knn",
    "scene": "same",
    "sampling": "uniform",
    "accumulate": None,
}
# Last revision with the removed keys.
BEFORE = "12c983c8"
# Folder of the code that all networks share.
CORE = "models/steering/core"
# Number of windows in a batch of predictions, which limits the memory.
WINDOWS = 96


class Trained(NamedTuple):
    """A trained network with everything needed to use it."""

    name: str
    # Seeds of all networks of the model.
    seeds: list[int]
    entry: Entry
    # Kind and sizes of the graphs that it was trained on.
    contents: Contents
    scale: Scale
    # Section → settings that made the files of its training drives.
    settings: dict[str, Any]
    # Names of its training drives.
    drives: list[str]
    # Datasets of its training drives, [] if unknown.
    datasets: list[str]
    # Frame rate of its training drives.
    fps: float
    net: SteeringNet

    @property
    def quantity(self) -> Quantity:
        """The quantity that the network predicts."""
        return load_quantity(self.entry.predict)(self.settings["labels"], self.entry.horizon)

    def predict(
        self, graphs: Graphs, motion: DriveReader | None = None, files: Files | None = None
    ) -> np.ndarray:
        """Return the predictions for the G frames of a file, float64 [G,R].

        `motion` is the drive's open motion file, which is read only if the network needs it.
        The columns are `scale.names`. The prediction for frame t uses the frames up to t, and is
        the quantity at frame t + `entry.horizon`. It is NaN if too few frames precede frame t in
        the drive, or since a gap, to fill a window. `files` may hold graph files that are open
        already. Raises InputError if the graphs have another kind of frames than the network was
        trained on, the motion that the network needs is missing, or an output is not finite.
        """
        if graphs.contents != self.contents:
            problem = f"model {self.name} expects {self.contents}, got {graphs.contents}"
            fix = f"Use graphs of input: {self.entry.input}, or train the model again"
            raise InputError(problem, graphs.path, fix)
        timeline = Timeline.read(graphs, motion, self.quantity, self.entry)
        reader = windows.Reader([timeline], self.entry.window, files)
        with error_context(f"model {self.name}: {graphs.path}"):
            return predict_drives(self.net, reader, self.scale)[0]


def load_model(folder: str | Path, device: torch.device | str | None = None) -> Trained:
    """Load best.pt of a trained model: data/train/<model>, or a folder seed-<n> in it.

    If `device` is None, the network is on a GPU if the machine has one. Raises InputError if the
    file is missing, or if this version of the code cannot rebuild the network.
    """
    path = Path(folder) / "best.pt"
    if not path.is_file():
        models = [
            *path.parent.glob("*/best.pt"),
            *path.parent.glob("data/train/*/best.pt"),
            *path.parent.parent.glob("*/best.pt"),
        ]
        names = ", ".join(sorted(str(best.parent) for best in models))
        fix = f"Trained models near it: {names or 'none'}. To train one: dvc repro train@MODEL"
        raise InputError("no trained model, best.pt is missing", folder, fix)
    fix = "Train it again: dvc repro --force --single-item train@MODEL. Or use it at revision "
    fix += f"{BEFORE}, which has networks and keys that were removed since"
    with error_context(fix=fix):
        content = checkpoint.read(path, KIND)
        try:
            with error_context(path):
                fields = _parse_checkpoint(content)
        except InputError:
            raise
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise InputError(
                f"not a model of this version ({shorten(repr(error), 200)})", path
            ) from error
        contents = fields["contents"]._asdict()
        net = fields["entry"].build(**contents, outputs=len(fields["scale"].names))
        checkpoint.load_state(net, content["net"], path)
    # Older checkpoints have no hashes.
    if "code" in content:
        _print_edits(fields["name"], fields["entry"], content["code"])
    if device is None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return Trained(**fields, net=net.to(device).eval())


def code_hashes(entry: Entry) -> dict[str, str]:
    """Return file → SHA-256 for the code of a model's networks and of its quantity."""
    paths = [ROOT / file for file in (*entry.files, "pipeline/train/quantity.py")]
    paths += sorted((ROOT / CORE).rglob("*.py"))
    return {str(path.relative_to(ROOT)): file_hash(path) for path in paths if path.is_file()}


def _print_edits(name: str, entry: Entry, hashes: Mapping[str, str]) -> None:
    """Print a line if files of the code differ from their `hashes` when the model was trained."""
    present = code_hashes(entry)
    edited = [file for file, before in hashes.items() if present.get(file) != before]
    if edited:
        _print_once(
            f"{name}: {', '.join(edited)} changed since its training, so its predictions may be "
            "wrong until it is trained again"
        )


@cache
def _print_once(text: str) -> None:
    """Print a line, unless this process has printed it: a model has a checkpoint per seed."""
    print(text, flush=True)


def _parse_checkpoint(content: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of Trained, all except `net`, from the content of a checkpoint."""
    entry = Entry.model_validate(without_removed(content["entry"]))
    fields = {name: content[name] for name in ("name", "seeds", "settings", "drives", "fps")}
    fields["datasets"] = content.get("datasets", [])
    contents = Contents(**without_removed(content["contents"]))
    settings = content["settings"]
    graphs = without_removed(settings.get("graphs", {}))
    fields["settings"] = settings | {"graphs": graphs}
    return fields | {"entry": entry, "contents": contents, "scale": Scale.parse(content["scale"])}


def without_removed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings without the removed keys. Raises InputError if another value is needed."""
    for key, value in REMOVED.items():
        if values.get(key, value) != value:
            raise InputError(f"{key} = {values[key]!r} is not supported any more")
    return {key: value for key, value in values.items() if key not in REMOVED}


def predict_drives(net: SteeringNet, reader: windows.Reader, scale: Scale) -> list[np.ndarray]:
    """Return the predictions [G,R] for the frames of each of the reader's timelines.

    A prediction is NaN if no window ends at the frame. Raises InputError if the network returns NaN
    or infinity for a window.
    """
    spans = windows.split_spans(reader.timelines, reader.window, WINDOWS)
    groups = [[span] for span in spans]
    outputs = []
    net.eval()
    with torch.inference_mode():
        for batch in reader.read_batches(groups, net.device):
            outputs.append(net(*net.inputs(batch)))

    # Outputs are read after the loop, so that the loop does not wait for the GPU.
    if outputs:
        is_finite = torch.cat(outputs).isfinite().all(dim=1)
        broken = int((~is_finite).sum())
        if broken:
            problem = f"the network returns NaN or infinity for {broken} of {len(is_finite)} frames"
            fix = "Look for a division by 0 or an overflow in models/steering/spatial or temporal"
            raise InputError(problem, fix=fix)

    # The windows of a span end at its last rows.
    values = [
        np.full((len(timeline.frame), len(scale.names)), np.nan) for timeline in reader.timelines
    ]
    for span, output in zip(spans, outputs, strict=True):
        values[span.drive][span.stop - len(output) : span.stop] = output.double().cpu().numpy()
    pairs = zip(values, reader.timelines, strict=True)
    return [scale.decode(output, timeline.base) for output, timeline in pairs]
