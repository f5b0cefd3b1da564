"""Measure the motion of a stream of frames with the stages' per-frame functions, without files.

Reading, perception and motion run in threads of their own. Memory holds a few frames.
"""

from collections.abc import Generator, Iterable
from pathlib import Path

import torch

from pipeline.camera.frame import Camera
from pipeline.camera.geometry import scale_K
from pipeline.camera.images import Size, resized
from pipeline.fitting.prefetch import prefetch
from pipeline.live.encoder_runner import EncoderRunner
from pipeline.live.frame_state import FrameState
from pipeline.live.source import Source
from pipeline.motion.estimator import MotionEstimator
from pipeline.motion.visual import Odometry
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
        self.camera = Camera(size, scale_K(source.K, source.size, size), source.T_cam_velo, source.camera_height_m)
        self._encoder = EncoderRunner(encoder, settings, self.camera) if encoder else None
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
                frame.depth, frame.cls = self._encoder.run(frame.image, frame.scan)
            yield frame

    def _measure(self, frames: Iterable[FrameState]) -> Generator[FrameState]:
        for frame in frames:
            frame.estimates = {kind: estimator.estimate(frame) for kind, estimator in self._estimators.items()}
            frame.problem = self.odometry.problem if self.odometry else ""
            yield frame
