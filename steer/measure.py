"""Measure the motion of a car from the frames of a source."""

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.checkout import revision
from pipeline.base.resume import ROOT
from pipeline.base.store import DriveReader
from pipeline.ingest.settings import Reading
from pipeline.labels.label import Car
from pipeline.perception.perceive import warnings
from pipeline.perception.settings import Perception
from steer.chain import INGEST, MOTION, Source, run_chain
from steer.outcome import Outcome, Results
from steer.pictures import publish

# Settings for reading a source. Images get the size with which the encoder was trained. If the
# source is a KITTI drive, the first of these cameras that has images is read.
READING = Reading(image_size=(192, 640), cameras=[2, 0, 3, 1], lidar=False, on_damaged="skip")


def measure(
    source: Source,
    out: Path | None,
    encoder: Path,
    car: Car,
    *,
    video: bool,
) -> Outcome:
    """Measure a source, and write motion.csv, track.png, quality.json and overlay.mp4.

    `out` is a new or empty folder for the files; if it is None, none are written. overlay.mp4 is
    written only if `video` is true. `encoder` is the folder of an encoder. Raises InputError if no
    frame can be read, or a log is unusable.
    """
    with run_chain(source, out, READING, Perception(batch=4), encoder) as work:
        results = Results.read(source, work, car, smooth=True)
        results.doubts += warnings(encoder, "float32", [work / INGEST])
        quality = _measure_quality(source, results, work)
        results.quality = quality
        notes = [*source.drive.notes, *results.lines(quality["comparison"])]
    files = publish(out, "motion.csv", results, source, car.wheelbase_m, video=video)
    return Outcome(results.columns(), notes, results.doubts, files)


def _measure_quality(source: Source, results: Results, work: Path) -> dict[str, Any]:
    """Return the content of quality.json. Unknown values are None."""
    with DriveReader(work / MOTION, stage="motion") as motion:
        facts = motion.attrs
    is_valid = results.table["valid"] > 0
    time_s = results.table["time_s"]
    camera = source.camera
    return {
        "version": version("semantic-steering"),
        "revision": revision(ROOT) or None,
        "source": str(source.path),
        "step_s": _median(np.diff(time_s)),
        "K": camera.K.round(3).tolist(),
        "camera_height_m": camera.height_m if camera.height_known else None,
        "horizon": camera.horizon,
        "measured_frames": facts["valid"] / max(facts["moving"], 1),
        "road_frames": facts["road_frames"] / facts["frames"],
        # Height in metres of the camera over the road, as the encoder's depth shows it.
        "road_height_m": facts["road_height_m"] or None,
        # Relative scatter of successive speeds, and standard deviation of the drive's scale.
        "scatter": facts["scatter"],
        "scale_sigma": facts["scale_sigma"],
        "speed_sigma": _median(results.table["speed_sigma"][is_valid]),
        "recorded": results.recorded,
        "comparison": results.compare("measured"),
    }


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
