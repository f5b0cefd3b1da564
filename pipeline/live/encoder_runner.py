"""Run the encoder on a stream of images: depth and classes as stage perception stores them."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.camera.frame import Camera
from pipeline.camera.geometry import scan_depth
from pipeline.encoder import precomputed
from pipeline.encoder.perceive import load, perceive
from pipeline.perception.depth_scale import DepthPostprocessor, needs_scan
from pipeline.sections.perception import Perception


class EncoderRunner:
    """Predicts depth and classes of the images of one drive; images come in order."""

    def __init__(self, encoder: Path, settings: Perception, camera: Camera) -> None:
        """Load the encoder of the folder `encoder`, usually data/encoder. Raises InputError if it has no network."""
        if folder := precomputed.named_in(encoder):
            fix = "Choose the folder of an encoder with a network: --encoder"
            raise InputError(f"depth and classes are precomputed in {folder}, so new images have none", encoder, fix)
        self._network, self._settings, self._camera = load(encoder), settings, camera
        self._postprocess = DepthPostprocessor(settings, camera.K, camera.height_m)

    def run(self, image: np.ndarray, scan: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return stored depth uint16 [H,W] and trainIds uint8 [H,W] of an image RGB uint8 [H,W,3]."""
        camera = self._camera
        (depth,), (cls,) = perceive(self._network, image[None], camera.K, self._settings.precision)
        scan_m = None
        if needs_scan(self._settings.depth_scale) and scan is not None and camera.T_cam_velo is not None:
            scan_m = scan_depth(scan, camera.T_cam_velo, camera.K, camera.size)
        return self._postprocess(depth, cls, scan_m), cls
