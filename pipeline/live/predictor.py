"""Predict steering from measured frames with the stages' per-frame functions: clouds, graphs, and a network.

The network's input is made in a thread of its own. Memory holds the features of one window. Predictions equal those of
stage evaluate: random draws depend on drive and frame number alone, and a CPU encodes one image at a time in both.
"""

import math
import time
from collections import deque
from collections.abc import Generator, Iterable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from models.steering.core.batch import from_arrays
from pipeline.base.errors import InputError
from pipeline.camera.camera import Camera
from pipeline.graphs import frame_graph
from pipeline.graphs.accumulate import Accumulator
from pipeline.graphs.cloud import stored_cloud
from pipeline.graphs.graph_file import Column, Columns, MeasuredMotion
from pipeline.labels import label
from pipeline.live.chain import Chain, FrameState
from pipeline.live.course import SpeedFilter, add_courses
from pipeline.live.results import PREDICTED_FILES, STEERING, TRACK, Results, result_folder, write_frames
from pipeline.live.settings import Settings, focal_by_width
from pipeline.live.source import Source
from pipeline.live.track import draw_track
from pipeline.motion.speed import LEAST_NOISE
from pipeline.perception.perceive import FILE
from pipeline.settings.ingest import SAMPLE
from pipeline.train import windows
from pipeline.train.labelled_drive import Timeline
from pipeline.train.predict import Trained
from pipeline.train.prefetch import prefetch

TOLERANCE = 0.2  # relative, of the frame rate and of the focal length


def needs_scans(model: Trained, settings: Settings) -> bool:
    """Return whether the model's input is made from LiDAR scans."""
    return settings.variant.source == "clouds/lidar"


def motion_kinds(model: Trained, settings: Settings) -> set[str]:
    """Return the kinds of motion that the model's input is made from."""
    accumulate = settings.variant.accumulate
    kinds: set[str] = {model.entry.motion} | ({"visual"} if accumulate else set())
    return kinds - {"none"}


def differences(model: Trained, source: Source, fitted_focal: float | None) -> list[str]:
    """Return where a source differs from what the model was fitted to; `fitted_focal` by width, None: unknown."""
    texts, card = [], model.card
    rendered = card and all(drive.startswith(SAMPLE) for drive in card.drives)
    if rendered and not source.name.startswith(SAMPLE):
        texts.append("it was fitted to the rendered sample alone, so expect wrong angles on real streets")
    if card and abs(source.fps / card.fps - 1) > TOLERANCE:
        texts.append(f"it was fitted to {card.fps:.1f} frames/s, got {source.fps:.1f}")
    focal = source.cropped.K[0, 0] / source.crop.size[1]
    if fitted_focal and abs(focal / fitted_focal - 1) > TOLERANCE:
        texts.append(f"it was fitted to a focal length of {fitted_focal:.2f} image widths, got {focal:.2f}")
    return [f"warning: model {model.name}: {text}" for text in texts]


def predict(
    model: Trained,
    settings: Settings,
    source: Source,
    data: Path,
    encoder: Path,
    out: Path,
    *,
    video: bool,
    visible: bool,
) -> Results:
    """Write steering.csv, track.png and the video to `out`.

    Args:
        data: with stage ingest's files, if there are any, for a comparison of the cameras.
        encoder: folder of an encoder, if the model needs one.
        visible: show a progress bar.
    Raises:
        InputError: the source lacks an input of the model, or no frame can be read.
    """
    source.notes += differences(model, source, focal_by_width(data))
    kinds, car = motion_kinds(model, settings), model.car
    perceives = (encoder / FILE).is_file() or settings.variant.source != "ingest" or "visual" in kinds
    kinds |= {"visual"} if perceives else set()
    with closing(source.frames) as frames:
        camera, used = source.cropped.scaled(settings.ingest.image_size), encoder if perceives else None
        chain = Chain(camera, source.name, used, kinds, settings.perception, road_scale=True)
        predicted = Predictor(model, settings, source, camera).run(chain.run(frames))
        courses = add_courses(predicted, car, smooth=False, height_known=source.height_known)
        with result_folder(out, *PREDICTED_FILES) as folder:
            results = write_frames(
                courses,
                folder / STEERING,
                source,
                car,
                warm_up=model.entry.window,
                video=video,
                visible=visible,
                ahead_m=model.ahead_m,
                uncertainty=model.entry.uncertainty,
            )
            draw_track(folder / TRACK, source.name, results)
    return results


class Predictor:
    """Runs clouds, graphs and a trained network on the frames of one source."""

    def __init__(self, model: Trained, settings: Settings, source: Source, camera: Camera) -> None:
        """Raises InputError if the source lacks an input."""
        if needs_scans(model, settings) and not source.has_scans:
            entry = model.entry
            needs = f"model {model.name} needs LiDAR scans (input: {entry.input}, motion: {entry.motion})"
            raise InputError(needs, source.name, "Choose a model without them")
        self.model, self._settings, self._drive, self._camera = model, settings, source.name, camera
        variant = settings.variant
        self._accumulator = Accumulator(variant.accumulate.frames) if variant.accumulate else None

    def run(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Yield each frame with its prediction, in order; closes `frames`."""
        with closing(prefetch(self._build_inputs(frames), 1)) as inputs:
            yield from self._predict(inputs)

    def _build_inputs(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Add the spatial network's input; drop frames without the scan that it is made from."""
        with closing(frames):
            for frame in frames:
                if self._settings.variant.kind == "image":
                    assert frame.image is not None
                    frame.arrays = _single({"image": Column(frame.image[None], "RGB", "ptr")})
                elif self._settings.variant.source == "clouds/lidar" and frame.scan is None:
                    continue
                else:
                    frame.arrays = self._points(frame)
                yield frame

    def _points(self, frame: FrameState) -> dict[str, np.ndarray]:
        """Return a frame of a variant of points as a batch."""
        variant, number = self._settings.variant, frame.number
        kind = variant.source.removeprefix("clouds/")
        cloud = stored_cloud(frame, kind, self._camera, self._drive, self._settings.clouds)
        if self._accumulator and variant.accumulate:
            T_before = None
            if estimate := frame.estimates["visual"]:
                T_before = estimate.step.T_before.astype(np.float32).astype(np.float64)
                T_before[:3, 3] /= estimate.step.scale if variant.source == "clouds/pseudo" else 1.0
            cloud = self._accumulator.add(number, cloud, T_before)
        return _single(frame_graph.build(cloud, variant, self._drive, number))

    def _predict(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        """Add the angle or the path predicted after each frame that completes a window."""
        net, entry = self.model.net, self.model.entry
        stream = _Stream(self.model)
        features: deque[torch.Tensor] = deque(maxlen=entry.window)  # each [1,F]
        speeds = SpeedFilter()
        for frame in frames:
            motion = None
            if estimate := frame.estimates.get(entry.motion):
                road = math.isfinite(frame.road_height_m)
                speed_mps, _ = speeds.add(frame.time_s, float(np.float32(estimate.speed_mps)), road, LEAST_NOISE)
                motion = estimate.yaw_rate_radps, speed_mps
            window = stream.add(frame.number, frame.time_s, motion)
            with torch.inference_mode():
                batch: Any = from_arrays(frame.arrays, net.device)
                original = net.spatial(batch)
                features.append(original - net.spatial(batch.mirrored()) if net.equivariant else original)
                if window:
                    others: Any = net.inputs(frame.arrays | window)[1:]
                    output = net.span_windows(torch.cat([*features]), *others)
                    predicted = self.model.scale.decode(output.double().cpu().numpy().reshape(1, -1), window["base"])
                    mean = predicted.mean[0].tolist()
                    sigma = None if predicted.sigma is None else predicted.sigma[0].tolist()
                    if entry.predict == "path":
                        frame.path_1pm, frame.path_sigma_1pm = mean, sigma
                    else:
                        frame.predicted_rad, frame.sigma_rad = mean[0], sigma and sigma[0]
            frame.latency_s = time.perf_counter() - frame.started_s
            yield frame


def _single(columns: Columns) -> dict[str, np.ndarray]:
    """Return one frame as a batch."""
    pointers = {column.pointer: np.array([0, len(column.rows)]) for column in columns.values()}
    return {
        name: column.rows.astype(np.int32) if column.refers_to else column.rows for name, column in columns.items()
    } | pointers


class _Stream:
    """The windows of frames that arrive one by one, as :func:`windows.batches` reads them from a file."""

    def __init__(self, model: Trained) -> None:
        self._entry, self._car = model.entry, model.car
        # The last `window` frames, and before them the latest older frame whose measured angle is still held.
        self._frames: list[tuple[int, float, float, float, int]] = []

    def add(self, number: int, time_s: float, motion: tuple[float, float] | None) -> dict[str, np.ndarray] | None:
        """Return the window that ends with this frame, without the frames' arrays; None if it is not complete.

        `motion`: yaw rate and speed; None if they are not measured.
        """
        self._frames.append((number, time_s, *(motion or (0.0, 0.0)), int(motion is not None)))
        frame, times, yaw_rate, speed, valid = map(np.array, zip(*self._frames, strict=True))
        measured = MeasuredMotion(yaw_rate.astype(np.float32), speed.astype(np.float32), valid.astype(np.uint8))
        entry, last = self._entry, len(frame) - 1
        graphs: Any = SimpleNamespace(path=Path(), frame=frame, time_s=times, motion=measured)
        timeline = Timeline.read(graphs, self._car, entry.motion, entry.base, entry.predict)
        older = slice(0, max(0, len(frame) - entry.window))
        held = np.flatnonzero(label.is_usable(measured.speed_mps, valid, self._car.min_speed_mps)[older])[-1:]
        self._frames = [self._frames[row] for row in held] + self._frames[-entry.window :]
        group = windows.spans([timeline], entry.window, 1, [np.array([last])])
        return windows._windows([timeline], group, entry.window) if group else None
