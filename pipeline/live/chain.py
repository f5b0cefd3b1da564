"""Measure the motion of a stream of frames with the stages' per-frame functions, without files.

Reading, perception and motion run in threads of their own. Memory holds a few frames.
"""

from collections.abc import Generator, Iterable
from pathlib import Path

import torch

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
        self._drive = source.name
        self._encode = open_encoder(encoder, settings.precision) if encoder else None
        self._postprocess = DepthPostprocessor(settings, self.camera)
        self._estimators = {kind: MotionEstimator(kind, self.camera, road_scale=road_scale) for kind in kinds}
        odometries = (estimator.odometry for estimator in self._estimators.values())
        self.odometry = next((visual for visual in odometries if isinstance(visual, Odometry)), None)

    def run(self, frames: Generator[FrameState]) -> Generator[FrameState]:
        """Yield each frame with depth, classes and estimates of motion, in order; closes `frames`."""
        return self._measure(prefetch(self._perceive(prefetch(frames, 1)), 1))

    def _perceive(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        torch.set_num_threads(1)  # of this thread, as in stage perception
        for frame in frames:
            frame.image = resized(frame.source_image, self.camera.size)
            if self._encode:  # depth and classes equal those that stage perception stores
                batch = Batch(self._drive, [frame.number], frame.image[None], self.camera, [frame.scan])
                (depth_m,), (frame.cls,) = self._encode(batch)
                frame.depth_m = rounded_as_stored(self._postprocess(depth_m, frame.cls, frame.scan))
            yield frame

    def _measure(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        for frame in frames:
            frame.estimates = {kind: estimator.estimate(frame) for kind, estimator in self._estimators.items()}
            if self.odometry:
                frame.problem, frame.road_height_m = self.odometry.problem, self.odometry.road.frame_height_m
            yield frame
