"""Steering from a trained network, in validation, in stage evaluate and in a notebook alike.

from pipeline.train import frames, predict

model = predict.load("data/train/sa-gnn-ncp")
with frames.open_graphs("data/graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
    steering_rad = model.predict(graphs, [60, 61, 200])
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.base.errors import InputError, error_context
from pipeline.base.params import parse
from pipeline.fitting import checkpoint
from pipeline.fitting.prefetch import prefetch
from pipeline.train import frames, runs, windows
from pipeline.train.distributed import World

if TYPE_CHECKING:
    import torch
    from torch import Tensor, nn

    from models.steering.core.steering_net import SteeringNet

KIND = "steering net"  # of checkpoint
WINDOWS = 96  # per batch when nothing is learned: what bounds the memory

Forward = Callable[[Any, windows.Batch], "Tensor"]
"""A network and a batch of arrays → its answers [W] in units of the target's deviation, on the network's device."""


@dataclass(frozen=True)
class Target:
    """What the network learns of the training drives' steering, and what its answer means.

    Θ = base + std · answer: base is the measured angle of the last frame seen, 0 without motion, and std the deviation
    of Θ - base. So an answer of 0 stays straight ahead, or on the course measured. The mean of Θ is for the predictor
    that knows nothing else.
    """

    mean_rad: float
    std_rad: float
    wheelbase_m: float
    min_speed_mps: float

    @classmethod
    def of(cls, drives: Sequence[windows.Drive]) -> "Target":
        steering = np.concatenate([drive.steering_rad[drive.valid] for drive in drives])
        left_open = np.concatenate([(drive.steering_rad - drive.base_rad)[drive.valid] for drive in drives])
        spread = max(float(left_open.std()), 1e-6)  # a road without a bend has none
        return cls(float(steering.mean()), spread, **vars(drives[0].car))

    @property
    def car(self) -> windows.Car:
        return windows.Car(self.wheelbase_m, self.min_speed_mps)


TARGET = tuple(field.name for field in fields(Target))
_KINDS: dict[str, type] = {"name": str, "seed": int, "contents": dict, "model": dict, "target": dict, "net": dict}


@dataclass(frozen=True)
class Trained:
    """A trained network with all that it takes to use it."""

    name: str
    seed: int
    fold: str | None  # the test drive that it was not fitted to, if it was fitted to the others
    line: dict[str, Any]  # as resolved when it was trained: input, spatial, temporal, window, …
    contents: dict[str, Any]  # of the graph files it was trained on, see frames.Graphs
    target: Target
    net: "SteeringNet"

    @property
    def window(self) -> int:
        """Frames that a prediction sees."""
        return int(self.line["window"])

    @property
    def horizon(self) -> int:
        """How many frames after the last one seen the predicted angle is driven."""
        return int(self.line["horizon"])

    def predict(self, graphs: frames.Graphs, numbers: Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Return the steering in rad, left +, for frames of an open graph file: float64, one per frame.

        What is returned for frame t is the angle at frame t + :attr:`horizon`, by what is seen until t. NaN where no
        whole window ends: too early in the drive, or too soon after a gap. Each frame is read and encoded once, however
        many windows hold it, at most WINDOWS windows at a time.

        Args:
            graphs: of :func:`frames.open_graphs`.
            numbers: KITTI frame numbers, in any order; None: all frames of the file.
        Raises:
            InputError: the file holds another kind of frames than the network was trained on, lacks the motion that it
                takes, or has no such frame.
        """
        from models.steering.core import steering_net

        if graphs.contents != self.contents:
            raise InputError(
                f"model {self.name} expects {frames.described(self.contents)}, but {graphs.path} holds "
                f"{frames.described(graphs.contents)}: give it graphs of input: {self.line['input']} as it was trained "
                f"on, or train it again: dvc repro --force --single-item train@{self.name}"
            )
        with error_context(where=f"model {self.name}"):
            timeline = windows.Timeline.of(graphs, self.line["motion"], self.target.car)
        rows = np.arange(len(timeline.frame)) if numbers is None else timeline.rows_of(numbers)
        (steering_rad,) = over_drives(
            self.net, steering_net.predict, [timeline], self.window, self.target, rows=[rows], opened={0: graphs}
        )
        return steering_rad[rows]

    @property
    def wiring(self) -> dict[str, Any] | None:
        """Who listens to whom in its recurrent network, as lists; None if it has no wiring.

        Neurons are numbered motor, command, inter, which say how many; sensory and internal: [from, to, ±1], …
        """
        from models.steering.core import steering_net

        wiring = steering_net.wiring_of(self.line)
        if wiring is None:
            return None
        synapses = {
            name: [[*map(int, pair), int(matrix[tuple(pair)])] for pair in np.argwhere(matrix)]
            for name, matrix in (("sensory", wiring.sensory), ("internal", wiring.internal))
        }
        return {"motor": wiring.motor, "command": wiring.command, "inter": wiring.inter, **synapses}

    def activity(self, graphs: frames.Graphs, start: int, stop: int) -> np.ndarray:
        """Return the recurrent network's state [stop - start, U] where windows end at rows [start, stop) of a file.

        Every window must be whole; the file as of :meth:`predict`.
        """
        import torch

        from models.steering.core import steering_net

        timeline = windows.Timeline.of(graphs, self.line["motion"], self.target.car)
        spans = [windows.Span(0, start - self.window + 1, stop)]
        with torch.inference_mode():
            (batch,) = windows.batches([timeline], [spans], self.window, {0: graphs})
            state: np.ndarray = steering_net.activity(self.net, batch).double().cpu().numpy()
        return state


def load(folder: str | Path, device: "torch.device | str | None" = None) -> Trained:
    """Load the best epoch of a trained model: data/train/<model>, or a folder seed-<n> or fold-<drive> in it.

    Args:
        folder: its best.pt holds all that is needed; neither params.yaml nor graphs are read.
        device: where to compute; None: a GPU if there is one.
    Raises:
        InputError: `folder` is not a trained model, or one that this code cannot rebuild; its best.pt is of another run
            than the config.json beside it.
    """
    import torch

    from models.steering.core import steering_net

    folder = Path(folder)
    path, name = folder / "best.pt", runs.model_name(folder)
    if not path.is_file():
        models = sorted(best.parent.name for best in folder.glob("*/best.pt"))
        hint = f"name one of those in it: {', '.join(models)}" if models else f"train it: dvc repro train@{name}"
        raise InputError(f"{folder} is not a trained model, best.pt is missing: {hint}")
    with error_context(fix=f"Train it again: dvc repro --force --single-item train@{name}"):
        content = checkpoint.read(path, KIND)
        whole = ("name", "seed", "fold", "contents", "net")
        for key, kind in _KINDS.items():
            if key in content and not isinstance(content[key], kind):
                raise InputError(f"{path} holds {type(content[key]).__name__} as {key}, and not what was trained")
        missing = _missing(content, *whole, model=steering_net.GENERAL, target=TARGET)
        if missing:
            raise InputError(f"{path} lacks {', '.join(sorted(missing))}: an older version of this project wrote it")
        with error_context(where=str(path)):
            if not all(isinstance(value, float) and math.isfinite(value) for value in content["target"].values()):
                raise InputError(f"target = {content['target']} are not numbers")
            if content["target"]["std_rad"] <= 0:
                raise InputError(f"target.std_rad = {content['target']['std_rad']} is no deviation")
            net = _built(content)
        checkpoint.load_state(net, content["net"], path)
    runs.check_pair(path)
    net.to(device or ("cuda" if torch.cuda.is_available() else "cpu")).eval()
    return Trained(
        name=content["name"],
        seed=content["seed"],
        fold=content["fold"],
        line=content["model"],
        contents=content["contents"],
        target=Target(**{key: content["target"][key] for key in TARGET}),
        net=net,
    )


def _built(content: Mapping[str, Any]) -> "SteeringNet":
    """Build the network of a checkpoint. Raises InputError or ValueError."""
    from models.steering.core import steering_net

    parse(runs.Line, content["model"], "model")
    try:
        return steering_net.build(content["model"], **content["contents"])
    except (TypeError, KeyError, AttributeError, IndexError) as error:
        raise ValueError(f"its model is not a line of params.yaml, or its contents no graphs': {error}") from error


def _missing(content: Mapping[str, Any], *keys: str, **within: Sequence[str]) -> list[str]:
    """Return which of `keys`, and of the keys `within` a mapping of that name, `content` lacks."""
    whole = [key for key in [*keys, *within] if key not in content]
    return whole + [
        f"{name}.{key}" for name, inner in within.items() for key in inner if key not in content.get(name, inner)
    ]


def over_drives(
    net: "nn.Module",
    forward: Forward,
    timelines: Sequence[windows.Timeline],
    window: int,
    target: Target,
    world: World = World(),
    rows: Sequence[np.ndarray] | None = None,
    opened: Mapping[int, frames.Graphs] | None = None,
) -> list[np.ndarray]:
    """Return the steering in rad that `net` predicts for each timeline's frames, [G] each; NaN where no window ends.

    With `rows`, int [..] of each timeline, at least theirs, and no frame is encoded for others. The processes of a
    `world` share the work, and all get the whole. `opened` as in :func:`windows.batches`.
    """
    import torch

    spans = windows.spans(timelines, window, WINDOWS, rows)
    own = [spans[index] for index in world.share(len(spans))]
    net.eval()
    with torch.inference_mode():
        read = prefetch(windows.batches(timelines, [[span] for span in own], window, opened))
        predicted = [batch["base_rad"] + target.std_rad * forward(net, batch).double().cpu().numpy() for batch in read]
    steering_rad = [np.full(len(timeline.frame), np.nan) for timeline in timelines]
    for part in world.gather(list(zip(own, predicted, strict=True))):
        for span, values in part:
            steering_rad[span.drive][span.start + window - 1 : span.stop] = values
    return steering_rad


def ms_per_frame(net: "nn.Module", encode: Forward, drives: Sequence[windows.Timeline], window: int) -> float:
    """Return the median time of ``encode(net, batch)`` per frame, in ms, over a few batches after a warm-up."""
    import torch

    groups = [[span] for span in windows.spans(drives, window, WINDOWS)][:6]
    times = []
    with torch.inference_mode():
        for (span,), batch in zip(groups, windows.batches(drives, groups, window), strict=True):
            started = time.perf_counter()
            encode(net, batch).cpu()  # waits for the device
            times.append((time.perf_counter() - started) / (span.stop - span.start))
    return float(np.median(times[1:] or times)) * 1e3
