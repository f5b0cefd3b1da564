"""Write the preset of an imported recording that is split into drives for training, validation and testing."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera
from pipeline.motion.visual import MAX_DEPTH_M, WIDE

_TEXT = """\
# Train networks on this recording and test them on its end: make street, then make {name}
ingest:
  source: kitti                 # data/raw
  image_size: [192, 640]        # the depth network's training size
  lidar: false
  drives: {{{drives}}}
  manifests:                    # hashes of the imported files: a repeated import runs the stages again
{manifests}

encoder:                        # of real streets, by make street
  backbone: street
  weights: weights/street/encoder.pt
  epochs: 0

{perception}labels:
  source: {source}

clouds:
  max_depth_m: {max_depth_m:.0f}{depth_comment}

graphs:
  "*": null                     # removes those of params.yaml
  depth: {{source: clouds/pseudo, points: 1000, k: 6}}

models:                         # {models_comment}
  "*": null
  motion: {{input: depth, {network}, motion: visual{base}{horizon}}}
  scene: {{input: depth, {network}{horizon}}}

train:
  epochs: 40                    # a single recording is small{rescale}
"""


def check_unchanged(path: Path) -> None:
    """Raise InputError if there is a file at `path` that is not as steer import wrote it."""
    if path.exists():
        first, _, rest = path.read_text("utf-8", errors="replace").partition("\n")
        if first != _first_line(rest):
            raise InputError("is not as steer import wrote it", path, "Move it away, or pass another --drive")


def _first_line(rest: str) -> str:
    return f"# Written by steer import; SHA-256 of the other lines: {hashlib.sha256(rest.encode()).hexdigest()}"


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
    ratio = float(camera.K[0, 0]) / camera.size[1] / WIDE
    text = _TEXT.format(
        name=path.stem,
        drives=", ".join(f"{split}: [{drive}]" for split, drive in zip(SPLITS, manifests, strict=True)),
        manifests="\n".join(f"    {drive}: {manifest}" for drive, manifest in manifests.items()),
        source=source,
        perception=f"perception:\n  camera_height_m: {height_m:g}\n\n" if height_m else "",
        max_depth_m=MAX_DEPTH_M * max(1.0, ratio),
        depth_comment="              # far things are large in a narrow view" if ratio > 1 else "",
        models_comment="the angle a second ahead" if source == "visual" else "the present angle",
        network="spatial: gnn, temporal: ncp, semantics: 0.0, equivariant: true",
        base=", base: none" if source == "wheel" else "",
        horizon=f", horizon: {max(1, round(hz))}" if source == "visual" else "",
        rescale="\n  rescale: 1.0                  # recorded angles do not scale with the scene" * (source == "wheel"),
    )
    with replacing(path) as unfinished:
        unfinished.write_text(f"{_first_line(text)}\n{text}", encoding="utf-8")
