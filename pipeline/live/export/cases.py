"""Real windows to verify an exported network by, with what the network itself says of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.live.export.parts import Arrays
from pipeline.train import frames, windows
from pipeline.train.predict import Trained


@dataclass(frozen=True)
class Case:
    """A window of T frames, and what the network says of it."""

    drive: str
    number: int  # of the last frame, KITTI's
    frames: list[Arrays]  # of each frame
    inputs: Arrays  # of the recurrent part but the features: dt_s [1,T], motion [1,T,4] with motion
    base_rad: float
    features: np.ndarray  # [T,F]
    steering_rad: float

    def answer(self, std_rad: float) -> float:
        """Return the steering as the recurrent part says it."""
        return (self.steering_rad - self.base_rad) / std_rad


def read(model: Trained, graphs: Path, drives: int = 4, each: int = 4) -> list[Case]:
    """Read windows of some drives of a graph variant's folder, of its test drives first, evenly spread over each.

    Raises InputError if the folder holds other frames than the model was trained on, or no whole window.
    """
    splits = store.read_index(graphs, stage="graphs")
    names = [drive for split in reversed(SPLITS) for drive in store.of_split(splits, split)]
    cases: list[Case] = []
    for drive in names:
        with frames.open_graphs(graphs / f"{drive}.h5") as file:
            cases += _of_drive(model, drive, file, each)
        if len({case.drive for case in cases}) == drives:
            break
    if not cases:
        raise InputError(f"{graphs} holds no window of {model.window} consecutive frames to verify the export by")
    return cases


def _of_drive(model: Trained, drive: str, graphs: frames.Graphs, count: int) -> Iterator[Case]:
    said = model.predict(graphs)  # which sees to it that the frames are what the model expects
    timeline = windows.Timeline.read(graphs, model.line["motion"], model.target.car)
    for row in _spread(np.flatnonzero(~np.isnan(said)).tolist(), count):
        first = row - model.window + 1
        span = [windows.Span(0, first, row + 1)]
        (batch,) = windows.batches([timeline], [span], model.window, {0: graphs})
        with torch.inference_mode():
            features = model.net.encode(model.net.frames(batch)).numpy()
        motion = {"motion": batch["motion"][None]} if "motion" in batch else {}
        yield Case(
            drive=drive,
            number=int(timeline.frame[row]),
            frames=[graphs.read(number, number + 1) for number in range(first, row + 1)],
            inputs={"dt_s": batch["dt_s"], **motion},
            base_rad=float(batch["base_rad"][0]),
            features=features,
            steering_rad=float(said[row]),
        )


def _spread(rows: Sequence[int], count: int) -> list[int]:
    """Return `count` of the rows, or all, evenly spread, first and last among them."""
    places = np.linspace(0, len(rows) - 1, min(count, len(rows))).round().astype(int)
    return [rows[place] for place in places]
