"""Write the preset of an imported recording that is split into drives for training, validation and testing."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import SPLITS
from pipeline.camera.camera import Camera
from pipeline.motion.visual import MAX_DEPTH_M, WIDE

FIRST_LINE = "# Written by steer import."
_TEXT = """\
{first_line} Train networks on this recording and test them on its end: make street, then make {name}
ingest:
  source: kitti                 # data/raw
  image_size: [192, 640]        # the depth network's training size
  lidar: false
  drives: {{{drives}}}

encoder:                        # depth of real streets without classes, by make street
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


def check_replaceable(path: Path) -> None:
    """Raise InputError if there is a file at `path` that steer import did not write."""
    if path.exists() and not (path.is_file() and path.read_text("utf-8", errors="replace").startswith(FIRST_LINE)):
        raise InputError("expected a preset that steer import wrote", path, "Move it away, or pass another --drive")


def write(
    path: Path, drives: Sequence[str], source: str, hz: float, camera: Camera, height_m: float | None = None
) -> None:
    """Write a preset with two models, with and without measured motion as input.

    Args:
        path: in presets/.
        drives: for training, validation and testing.
        source: of the labels. Motion that is the label cannot be an input for the same frame, so visual labels are
            predicted a second ahead. The scale of a wheel's angle and of measured motion may differ: base is none.
        hz: images per second.
        height_m: of the camera over the road, which gives measured motion its scale; None: KITTI's.
        camera: of the images. Depth grows with focal length / width, and so does its limit.
    """
    check_replaceable(path)
    ratio = float(camera.K[0, 0]) / camera.size[1] / WIDE
    text = _TEXT.format(
        first_line=FIRST_LINE,
        name=path.stem,
        drives=", ".join(f"{split}: [{drive}]" for split, drive in zip(SPLITS, drives, strict=True)),
        source=source,
        perception=f"perception:\n  camera_height_m: {height_m:g}\n\n" if height_m else "",
        max_depth_m=MAX_DEPTH_M * max(1.0, ratio),
        depth_comment="              # far things are large in a narrow view" if ratio > 1 else "",
        models_comment="the angle a second ahead" if source == "visual" else "the present angle",
        network="spatial: gnn, temporal: ncp, window: 8, equivariant: true",
        base=", base: none" if source == "wheel" else "",
        horizon=f", horizon: {max(1, round(hz))}" if source == "visual" else "",
        rescale="\n  rescale: 1.0                  # recorded angles do not scale with the scene" * (source == "wheel"),
    )
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
