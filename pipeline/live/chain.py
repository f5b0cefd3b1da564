"""From images to steering, frame by frame: the stages ingest … graphs and a trained network, without files.

A frame is read while the one before is perceived, and the one before that becomes a graph: each in a thread of its own.
Memory holds a few frames and the features of a window. Numbers are those of the stages, as random draws depend on drive
and frame alone, and a CPU perceives images one at a time there as well.
"""

import time
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from models.steering.core.recurrent import NOMINAL_STEP_S
from pipeline.base.errors import InputError
from pipeline.fitting.prefetch import prefetch
from pipeline.graphs import accumulate
from pipeline.live.eyes import Eyes
from pipeline.live.inputs import Inputs
from pipeline.live.moment import Moment
from pipeline.live.odometry import MeasuredAngle, Odometry
from pipeline.live.settings import Settings
from pipeline.live.view import View
from pipeline.perception.depth_scale import MODES
from pipeline.train.predict import Trained


def takes_scans(model: Trained, settings: Settings) -> bool:
    """Whether a model needs LiDAR scans, beside images."""
    lidar = "lidar" in _motions(model, settings) or settings.graphs.source == "clouds/lidar"
    return lidar or MODES[settings.perception.depth_scale].needs_scan


def _motions(model: Trained, settings: Settings) -> set[str]:
    """The kinds of motion to be measured."""
    spanning = settings.graphs.accumulate
    return ({model.line["motion"]} | ({spanning.motion} if spanning else set())) - {"none"}


class Chain:
    """A trained model on what one camera sees."""

    def __init__(self, model: Trained, settings: Settings, encoder: Path, view: View) -> None:
        """Load the encoder of folder `encoder`, data/encoder, if the model's input needs one.

        Raises InputError if the source cannot give what the model takes.
        """
        self.model, self._settings, kinds = model, settings, _motions(model, settings)
        if takes_scans(model, settings) and not view.scans:
            raise InputError(
                f"model {model.name} takes LiDAR scans (input: {model.line['input']}, motion: {model.line['motion']}, "
                f"depth_scale: {settings.perception.depth_scale}), and {view.name} has none: choose another model"
            )
        self._eyes = Eyes(settings, encoder, view, settings.graphs.source == "ingest" and "visual" not in kinds)
        self.camera_height_m = self._eyes.camera_height_m
        size, T_cam_velo = settings.ingest.image_size, np.eye(4) if view.T_cam_velo is None else view.T_cam_velo
        height_m = self.camera_height_m if settings.motion.road_scale else None
        self._odometry = {kind: Odometry(kind, view.K_at(size), size, height_m, T_cam_velo) for kind in kinds}
        self._inputs = Inputs(settings, view)

    def angles(self, moments: Generator[Moment]) -> Generator[Moment]:
        """Yield each frame with what the model predicts after it, in order; closes `moments`."""
        seen = prefetch(self._eyes.perceived(prefetch(moments, 1)), 1)
        return self._steered(prefetch(self._inputs.given(self._measured(seen)), 1))

    def _measured(self, moments: Iterable[Moment]) -> Generator[Moment]:
        """Add the motion that the network is told of, and the step by which clouds span time."""
        spanning, source = self._settings.graphs.accumulate, self._settings.graphs.source
        for moment in moments:
            for kind, odometry in self._odometry.items():
                step, motion = odometry.measure(moment)
                if kind == self.model.line["motion"]:
                    moment.motion = motion
                if step and spanning and kind == spanning.motion:
                    T_before, scale = step.T_before.astype(np.float32), float(np.float32(step.scale))  # as stored
                    moment.T_before = accumulate.of_clouds(T_before, scale, source)
            yield moment

    def _steered(self, moments: Iterable[Moment]) -> Generator[Moment]:
        """Add the angle that the network says after each frame that ends a whole window."""
        model, window = self.model, self.model.window
        angle = MeasuredAngle(model.target.wheelbase_m, model.target.min_speed_mps)
        told = model.line["motion"] != "none"
        held: deque[_Heard] = deque(maxlen=window)
        for moment in moments:
            base_rad = angle.of(moment.motion) if told else 0.0
            if held and moment.number != held[-1].number + 1:
                held.clear()
            dt_s = moment.time_s - held[-1].time_s if held else NOMINAL_STEP_S
            with torch.inference_mode():
                features = model.net.encode(model.net.frames(moment.arrays))
                motion = (base_rad, *moment.motion)
                held.append(_Heard(moment.number, moment.time_s, dt_s, features, motion))
                if len(held) == window:
                    features = torch.cat([each.features for each in held])
                    said = model.net.recall(features, *model.net.windows(_window(held)))
                    moment.predicted_rad = float(np.float32(base_rad)) + model.target.std_rad * float(said)
            moment.latency_s = time.perf_counter() - moment.began_s
            yield moment


class _Heard(NamedTuple):
    """A frame of the window, as the recurrent network hears of it."""

    number: int
    time_s: float
    dt_s: float
    features: torch.Tensor  # [1,F]
    motion: tuple[float, float, float, bool]  # columns pipeline.train.windows.MOTION


def _window(held: Sequence[_Heard]) -> dict[str, np.ndarray]:
    """Return the arrays of a batch that is one window, without its frames."""
    return {
        "windows": np.arange(len(held))[None],
        "dt_s": np.array([[each.dt_s for each in held]], np.float32),
        "motion": np.array([each.motion for each in held], np.float32),
    }
