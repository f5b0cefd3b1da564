"""List settings and presets of earlier versions that were removed, and what to do instead."""

import re
from collections.abc import Iterator
from typing import Any

# Last revision with the presets and options of experiments whose question has been answered since.
# Their results are in docs/log.md.
LAST = "0919269e"
# Names of the presets that were removed after that revision.
PRESETS = ("real", "streets", "transfer", "winding", "winding-wheel")

# Removed setting → what to do instead. A setting is a dotted key, in which * stands for the name of
# an entry, or "key: value" if only this value was removed.
EARLIER = {
    "base": "Copy the settings of the presets that base names into this preset",
    "encoder.backbone: dinov2": f"Choose another one of docs/models.md, or use revision {LAST}",
    "encoder.frozen": "Remove it: a fit trains all weights",
    "encoder.targets": "Remove it: the fit takes ground truth of the drives",
    "encoder.teacher": "Remove it. Encoders of real streets are published ones: backbone: street",
    "encoder.weights.backbone": (
        "Set backbone to the encoder, for instance street (docs/models.md), and weights to null"
    ),
    "encoder.weights.class_head": (
        "Set backbone to the encoder, for instance street (docs/models.md), and weights to null"
    ),
    "evaluate.curvature_bins_1pm": "Remove it: bends and turns at junctions have fixed limits",
    "evaluate.path": "Remove it: paths are integrated by the bicycle model",
    "graphs.*.accumulate.frames": "Write the number itself: accumulate: 8",
    "graphs.*.cloud": "Write source: clouds/pseudo or clouds/lidar",
    "ingest.manifests": "Remove it and repeat steer import, which writes ingest.recordings",
    "ingest.source.train": "Name one dataset for all drives: source: kitti",
    "ingest.source.test": "Name one dataset for all drives: source: kitti",
    "ingest.source: both": "Name one dataset for all drives: source: kitti",
    "labels.source: lidar": "Write source: visual",
    "labels.standstill": (
        "Remove it: frames below min_speed_mps have no label. With min_speed_mps: 0, all frames "
        "have a label"
    ),
    "models.*.fit_to": "Remove it: networks are trained on the drives of ingest.drives.train",
    "models.*.motion: lidar": "Write motion: visual",
    "models.*.roads": "Remove it, and name fewer drives in ingest.drives.train",
    "models.*.train_drives": "Remove it, and name fewer drives in ingest.drives.train",
    "models.*.uncertainty": "Remove it: networks predict no standard deviation",
    "motion": "Remove the section: motion is always measured from the images",
    "perception.camera_height_m": (
        "Remove it. Pass --camera-height to steer import; KITTI has a calibrated height"
    ),
    "perception.depth_scale": "Remove it: stage motion scales depth by the camera's height",
    "pictures": "Remove the section: stage report draws the pictures",
    "sample.replay": "Remove it: the sample has roads of its own only",
    "town": "Rename the section: sample",
    "train.batch_runs": "Rename it: batch_spans",
    "train.keep": (
        "Remove it: weights are those of the lowest validation error, averaged over three epochs"
    ),
    "train.mirror": (
        "Remove it. Networks that treat left and right alike have equivariant: true in models"
    ),
    "train.noise": "Remove it: of the simulated errors, training has train.rescale only",
    "train.precision": "Remove it: training is in float32",
    "train.run_windows": "Rename it: span_windows",
}


def find_earlier(settings: Any, where: str) -> tuple[str, str]:
    """Return the first removed setting at or below the dotted key `where`, and what to do instead.

    Both texts are empty if there is none.
    """
    for key in _keys(settings, where):
        way_on = EARLIER.get(re.sub(r"^(models|graphs)\.[^.]+", r"\1.*", key))
        if way_on:
            return key, way_on
    return "", ""


def _keys(settings: Any, where: str) -> Iterator[str]:
    """Yield the dotted keys of nested settings, and "key: value" for each single value."""
    yield where
    if not isinstance(settings, dict):
        yield f"{where}: {settings}"
        return
    for name, part in settings.items():
        yield from _keys(part, f"{where}.{name}" if where else str(name))
