"""The encoder on a stream of images: depth and classes as stage perception stores them."""

from collections.abc import Generator, Iterable
from pathlib import Path

import numpy as np
import torch

from pipeline.base.errors import InputError
from pipeline.camera.geometry import scan_depth
from pipeline.camera.images import resized
from pipeline.camera.mount import camera_height
from pipeline.encoder import precomputed
from pipeline.encoder.perceive import load, perceive, stored_depth
from pipeline.live.moment import Moment
from pipeline.live.settings import Settings
from pipeline.live.view import View
from pipeline.perception.depth_scale import MODES, Frame
from pipeline.perception.ground_plane import put_on_ground


class Eyes:
    """What sees one camera's images; blind where nothing asks for depth or classes."""

    def __init__(self, settings: Settings, encoder: Path, view: View, blind: bool) -> None:
        """Load the encoder of folder `encoder`, data/encoder. Raises InputError if it cannot see."""
        if not blind and (folder := precomputed.named_in(encoder)):
            raise InputError(f"{encoder} takes depth and classes from {folder} and sees no image: take another encoder")
        self._encoder = None if blind else load(encoder)
        self._perception, self._size, self._view = settings.perception, settings.ingest.image_size, view
        self._K = view.K_at(self._size)
        self.camera_height_m = self._perception.camera_height_m or camera_height(view.T_cam_velo)

    def perceived(self, moments: Iterable[Moment]) -> Generator[Moment]:
        """Add to each frame its image at the encoder's size, and depth and classes."""
        torch.set_num_threads(1)  # of the thread that runs this, as in stage perception
        mode, factor = MODES[self._perception.depth_scale], 0.0
        for moment in moments:
            moment.small = resized(moment.image, self._size)
            if self._encoder is not None:
                precision = self._perception.precision
                (depth,), (cls,) = perceive(self._encoder, moment.small[None], self._K, precision)
                scan_m = self._scan_m(moment) if mode.needs_scan else None
                factor = mode.rescale(Frame(depth, cls, scan_m, self._K, self.camera_height_m), factor)
                if self._perception.reach:
                    put_on_ground(depth, cls, self._K, self.camera_height_m, self._perception.reach)
                moment.depth, moment.cls = stored_depth(depth, cls), cls
            yield moment

    def _scan_m(self, moment: Moment) -> np.ndarray | None:
        if moment.scan is None or self._view.T_cam_velo is None:
            return None
        return scan_depth(moment.scan, self._view.T_cam_velo, self._K, self._size)
