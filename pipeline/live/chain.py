"""Measure the motion of a stream of frames with the stages' per-frame functions, without files.

Reading, perception and motion run in threads of their own. Memory holds a few frames.
"""

from collections.abc import Generator, Iterable
from pathlib import Path

import numpy as np
import torch

from pipeline.camera.camera import Camera
from pipeline.camera.frame import Frame
from pipeline.camera.images import Size, resized, rounded_as_stored
from pipeline.fitting.prefetch import prefetch
from pipeline.live.course import FrameState
from pipeline.live.source import Source
from pipeline.motion.estimator import MotionEstimator
from pipeline.motion.visual import Odometry
from pipeline.perception.depth_scale import DepthPostprocessor
from pipeline.perception.perceive import Batch, open_encoder
from pipeline.sections.perception import Perception


class Chain:
    """Runs perception and motion on the frames of one source, whose images get the size `size`."""

    def __init__(
        self, source: Source, size: Size, encoder: Path | None, kinds: set[str], settings: Perception, road_scale: bool
    ) -> None:
        """Load the encoder of a folder; None: no depth, no classes.

        Args:
            kinds: of motion; visual needs an encoder.
            settings: of perception.
            road_scale: correct depth by the camera's height.
        """
        self.camera = source.camera.scaled(size)
        self._encoder = EncoderRunner(encoder, settings, self.camera, source.name) if encoder else None
        self._estimators = {kind: MotionEstimator(kind, self.camera, road_scale=road_scale) for kind in kinds}
        odometries = (estimator.odometry for estimator in self._estimators.values())
        self.odometry = next((each for each in odometries if isinstance(each, Odometry)), None)  # the visual one

    def run(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Yield each frame with depth, classes and estimates of motion, in order; closes `frames`."""
        return self._measure(prefetch(self._perceive(prefetch(frames, 1)), 1))

    def _perceive(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        torch.set_num_threads(1)  # of this thread, as in stage perception
        for frame in frames:
            frame.image = resized(frame.source_image, self.camera.size)
            if self._encoder:
                frame.depth_m, frame.cls = self._encoder.run(frame)
            yield frame

    def _measure(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        for frame in frames:
            frame.estimates = {kind: estimator.estimate(frame) for kind, estimator in self._estimators.items()}
            if self.odometry:
                frame.problem, frame.road_height_m = self.odometry.problem, self.odometry.road.frame_height_m
            yield frame


class EncoderRunner:
    """Predicts depth and classes of one drive's images, in order, equal to those that stage perception stores."""

    def __init__(self, encoder: Path, settings: Perception, camera: Camera, drive: str) -> None:
        """Load the encoder of the folder `encoder`, usually data/encoder."""
        self._predict, self._camera, self._drive = open_encoder(encoder, settings.precision), camera, drive
        self._postprocess = DepthPostprocessor(settings, camera)

    def run(self, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
        """Return depth [H,W] in metres, rounded as in a file, and trainIds uint8 [H,W] of a frame with an image."""
        assert frame.image is not None
        batch = Batch(self._drive, [frame.number], frame.image[None], self._camera, [frame.scan])
        (depth,), (cls,) = self._predict(batch)
        return rounded_as_stored(self._postprocess(depth, cls, frame.scan)), cls
