"""Predict steering with a trained network.

from pipeline.graphs import graph_file
from pipeline.train import predict
from pipeline.train.labelled_drive import Timeline, LabelledDrive

model = predict.load("data/train/sa-gnn-ncp")
with graph_file.open_graphs("data/graphs/semantic/2026_01_10_drive_0004.h5") as graphs:
    steering_rad = model.predict(graphs, [20, 21, 30])
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from pipeline.base.errors import InputError, error_context
from pipeline.graphs.graph_file import Contents, Graphs
from pipeline.labels import label
from pipeline.settings.models import Entry
from pipeline.train import checkpoint, runs, windows
from pipeline.train.distributed import World
from pipeline.train.labelled_drive import LabelledDrive, Timeline
from pipeline.train.path_target import PathPrediction, PathTarget
from pipeline.train.prefetch import prefetch

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from models.steering.core.steering_net import SteeringNet

KIND = "steering net"  # of checkpoint
WINDOWS = 96  # per batch of predictions; limits the memory


class Prediction(NamedTuple):
    """Predicted steering for G frames, NaN where no complete window ends.

    With uncertainty also its standard deviation, and half of the 95 % interval.
    """

    steering_rad: np.ndarray
    sigma_rad: np.ndarray | None = None
    half_95_rad: np.ndarray | None = None


@dataclass(frozen=True)
class Target:
    """Scale of the network's output, from the training drives: Θ = base + std · output.

    base is the measured angle of the window's last frame, or 0, see `base` of a model's entry; std is the standard
    deviation of the residual Θ - base. So output 0 means the base angle. The mean of Θ, and its regression coefficients
    on the measured angles by kind of motion, are for baselines. With uncertainty, σ = std · sigma_factor · exp(second
    output), and the 95 % interval is ± interval_95 · σ. Both are chosen on the validation drives: the highest
    likelihood of their errors, and the interval that contains 95 % of them, since large errors are more frequent than
    in a normal distribution.
    """

    mean_rad: FiniteFloat
    std_rad: Annotated[FiniteFloat, Field(gt=0)]
    wheelbase_m: FiniteFloat
    min_speed_mps: FiniteFloat
    coefficients: dict[str, FiniteFloat] = field(default_factory=dict)
    sigma_factor: FiniteFloat = 1.0
    interval_95: FiniteFloat = 1.96

    @classmethod
    def from_drives(cls, drives: Sequence[LabelledDrive]) -> "Target":
        steering = np.concatenate([drive.steering_rad[drive.valid] for drive in drives])
        residual = np.concatenate([(drive.steering_rad - drive.base_rad)[drive.valid] for drive in drives])
        std = max(float(residual.std()), 1e-6)  # 0 for a straight road
        coefficients = {}
        for kind in [kind for kind in drives[0].measured_rad if all(kind in drive.measured_rad for drive in drives)]:
            measured = np.concatenate([drive.measured_rad[kind][drive.valid] for drive in drives])
            known = np.isfinite(measured)
            if measured[known].any():
                coefficients[kind] = float(measured[known] @ steering[known] / (measured[known] @ measured[known]))
        return cls(float(steering.mean()), std, **vars(drives[0].car), coefficients=coefficients)

    @property
    def car(self) -> label.Car:
        return label.Car(self.wheelbase_m, self.min_speed_mps)

    @property
    def outputs(self) -> int:
        return 1

    def residual(self, batch: Mapping[str, "Tensor"]) -> "Tensor":
        """Return the output [W] that the network should have, from a batch's targets."""
        return (batch["steering_rad"] - batch["base_rad"]) / self.std_rad

    def decode(self, output: "Tensor", base_rad: np.ndarray) -> np.ndarray:
        """Return the fields of :class:`Prediction` for W windows, [1 or 3, W] in rad, of a network's output."""
        values = output.double().cpu().numpy().reshape(len(base_rad), -1).T
        steering_rad = base_rad + self.std_rad * values[0]
        sigma_rad = self.std_rad * self.sigma_factor * np.exp(values[1:])  # [0 or 1, W]
        return np.concatenate([steering_rad[None], sigma_rad, self.interval_95 * sigma_rad])

    def columns(self, uncertainty: bool) -> int:
        """Return the number of rows of :meth:`decode`."""
        return 3 if uncertainty else 1

    def prediction(self, values: np.ndarray) -> Prediction:
        """Return :meth:`decode`'s values, collected for G frames [1 or 3, G]."""
        return Prediction(*values)


class Card(BaseModel):
    """What a model was fitted to: names of drives, and their frame rate."""

    drives: list[str]
    fps: Annotated[FiniteFloat, Field(gt=0)]

    @classmethod
    def from_drives(cls, drives: Sequence[LabelledDrive]) -> "Card":
        steps_s = np.concatenate([np.diff(drive.time_s) for drive in drives])
        return cls(drives=[drive.name for drive in drives], fps=float(1 / np.median(steps_s)))


class Checkpoint(BaseModel):
    """Schema of best.pt."""

    name: str
    seed: int
    fold: str | None
    contents: Contents
    model: Entry
    target: Target | PathTarget
    card: Card | None = None
    net: dict[str, Any]


@dataclass(frozen=True)
class Trained:
    """A trained network with everything needed to use it."""

    name: str
    seed: int
    fold: str | None  # the test drive that was left out of training, with fit_to: others or both
    entry: Entry
    contents: Contents  # of the graph files it was trained on
    target: Target | PathTarget
    net: "SteeringNet"
    card: Card | None = None

    def check_same_scene(self) -> None:
        """Raise InputError for a control that needs the scene of another frame of a complete drive."""
        if self.entry.scene != "same":
            raise InputError(
                f"scene: {self.entry.scene} is a control for evaluation", f"model {self.name}", "Choose another model"
            )

    def predict(self, graphs: Graphs, numbers: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Return the steering in rad [G], or the path in 1/m [G,R], left +; see :meth:`predict_with_sigma`."""
        return self.predict_with_sigma(graphs, numbers)[0]

    def predict_with_sigma(
        self, graphs: Graphs, numbers: Sequence[int] | np.ndarray | None = None
    ) -> Prediction | PathPrediction:
        """Return the steering in rad, left +, and with uncertainty its σ: float64, one per frame of an open graph file.

        The value for frame t is the angle at frame t + `entry.horizon`, predicted from the frames up to t; of a model
        with predict: path the mean curvature of the path ahead, in each range of `target.ahead_m`. NaN where no
        complete window ends: too early in the drive, or too soon after a gap. Each frame is read and encoded once,
        with at most WINDOWS windows at a time.

        Args:
            graphs: from :func:`graph_file.open_graphs`.
            numbers: KITTI frame numbers, in any order; None: all frames of the file.
        Raises:
            InputError: the file has another kind of frames than the network was trained on, lacks the model's motion,
                or has no such frame.
        """
        if graphs.contents != self.contents:
            raise InputError(
                f"model {self.name} expects {self.contents}, got {graphs.contents}",
                graphs.path,
                f"Use graphs of input: {self.entry.input}, or train the model again: dvc repro --force --single-item "
                f"train@{self.name}",
            )
        with error_context(where=f"model {self.name}"):
            timeline = Timeline.read(graphs, self.entry.motion, self.target.car, self.entry.base, self.entry.scene)
        rows = np.arange(len(timeline.frame)) if numbers is None else timeline.rows(numbers)
        (predicted,) = predict_drives(
            self.net, [timeline], self.entry.window, self.target, rows=[rows], opened={0: graphs}
        )
        return type(predicted)(*(values[rows] for values in predicted if values is not None))


def load(folder: str | Path, device: "torch.device | str | None" = None) -> Trained:
    """Load the selected epoch of a trained model: data/train/<model>, or a folder seed-<n> or fold-<drive> in it.

    Args:
        folder: with best.pt, which is sufficient; params.yaml and graphs are not read.
        device: None: a GPU if there is one.
    Raises:
        InputError: `folder` has no trained model, this code cannot rebuild it, or its config.json is of another run.
    """
    import torch

    folder = Path(folder)
    path, name = folder / "best.pt", runs.model_name(folder)
    if not path.is_file():
        below, beside = (sorted(best.parent.name for best in at.glob("*/best.pt")) for at in (folder, folder.parent))
        fix = f"Choose one of its subfolders: {', '.join(below)}" if below else f"Train it: dvc repro train@{name}"
        fix += f". Trained models beside it: {', '.join(beside)}" if beside else ""
        raise InputError("no trained model, best.pt is missing", folder, fix)
    with error_context(fix=f"Train it again: dvc repro --force --single-item train@{name}"):
        content = checkpoint.read(path, KIND)
        with error_context(where=path):
            best = _parse(content)
            net = best.model.build(**best.contents.model_dump(), outputs=best.target.outputs)
        checkpoint.load_state(net, best.net, path)
    runs.check_pair(path)
    net.to(device or ("cuda" if torch.cuda.is_available() else "cpu")).eval()
    return Trained(best.name, best.seed, best.fold, best.model, best.contents, best.target, net, best.card)


def _parse(content: Mapping[str, Any]) -> Checkpoint:
    try:
        return Checkpoint.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error


def predict_drives(
    net: "SteeringNet",
    timelines: Sequence[Timeline],
    window: int,
    target: Target | PathTarget,
    world: World = World(),
    rows: Sequence[np.ndarray] | None = None,
    opened: Mapping[int, Graphs] | None = None,
    read: Callable[[Sequence[windows.Span]], Iterable[Mapping[str, Any]]] | None = None,
) -> list[Any]:
    """Return the target's predictions, :class:`Prediction` or :class:`PathPrediction`, for each timeline's frames.

    With `rows`, int [..] per timeline, at least for these; other frames are not encoded. The processes of a `world`
    share the work and all get the complete result. `opened` as in :func:`windows.batches`; `read` replaces it: a
    function that yields the batches of spans.
    """
    import torch

    spans = windows.spans(timelines, window, WINDOWS, rows)
    share = [spans[index] for index in world.share(len(spans))]
    net.eval()
    with torch.inference_mode():
        if read is None:
            batches: Any = prefetch(windows.batches(timelines, [[span] for span in share], window, opened))
        else:
            batches = read(share)
        outputs = [(net(*net.inputs(batch)), np.asarray(batch["base_rad"])) for batch in batches]
        predicted = [target.decode(*output) for output in outputs]  # after the loop, which so does not wait for a GPU
    columns = target.columns(net.uncertainty is not None)
    result = [np.full((columns, len(timeline.frame)), np.nan) for timeline in timelines]
    for part in world.gather(list(zip(share, predicted, strict=True))):
        for span, values in part:
            result[span.drive][:, span.start + window - 1 : span.stop] = values
    return [target.prediction(values) for values in result]
