"""Write the preset of an imported recording that is split into drives for training, validation and testing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera
from pipeline.motion.visual import MAX_DEPTH_M, WIDE
from pipeline.settings.preset import is_unedited, stamped


def check_unchanged(path: Path) -> None:
    """Raise InputError if there is a file at `path` that is not as steer import wrote it."""
    if path.exists() and not is_unedited(path):
        raise InputError("is not as steer import wrote it", path, "Move it away, or pass another --drive")


def write(
    path: Path, manifests: Mapping[str, str], source: str, hz: float, camera: Camera, height_m: float | None = None
) -> None:
    """Write a preset with two models, with and without measured motion as input.

    Args:
        manifests: drive for training, validation and testing → hash of its manifest.
        source: of the labels. Motion that is the label cannot be an input for the same frame, so visual labels are
            predicted a second, `hz` frames, ahead. A wheel's angle and measured motion may differ in scale: no base.
        camera: of the images. Depth grows with focal length / width, and so does its limit.
        height_m: of the camera over the road, which gives measured motion its scale; None: KITTI's.
    """
    network = {"input": "depth", "spatial": "gnn", "temporal": "ncp", "semantics": 0.0, "equivariant": True}
    if source == "visual":
        network["horizon"] = max(1, round(hz))
    settings: dict[str, Any] = {
        "ingest": {
            "source": "kitti",
            "image_size": [192, 640],  # the depth network's training size
            "lidar": False,
            "drives": {split: [drive] for split, drive in zip(SPLITS, manifests, strict=True)},
            "manifests": dict(manifests),
        },
        "encoder": {"backbone": "street", "weights": "weights/street/encoder.pt", "epochs": 0},
        "perception": {"camera_height_m": height_m} if height_m else {},
        "labels": {"source": source},
        "clouds": {"max_depth_m": float(round(MAX_DEPTH_M * max(1.0, camera.K[0, 0] / camera.size[1] / WIDE)))},
        "graphs": {"*": None, "depth": {"source": "clouds/pseudo", "points": 1000, "k": 6}},
        "models": {
            "*": None,
            "motion": network | {"motion": "visual"} | ({"base": "none"} if source == "wheel" else {}),
            "scene": network,
        },
        # A single recording is small. Recorded angles do not scale with the scene.
        "train": {"epochs": 40} | ({"rescale": 1.0} if source == "wheel" else {}),
    }
    text = f"# Train on this recording and test on its end: make street, then make {path.stem}\n"
    text += yaml.safe_dump(settings, sort_keys=False)
    with replacing(path) as unfinished:
        unfinished.write_text(stamped(text, "steer import"), encoding="utf-8")
