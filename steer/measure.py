"""Measure the motion of a car from the frames of a source."""

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.resume import ROOT, revision
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
    fit_ratio: bool = False,
) -> Outcome:
    """Measure a source, and write motion.csv, track.png, quality.json and overlay.mp4.

    `out` is a new or empty folder for the files; if it is None, none are written. overlay.mp4 is
    written only if `video` is true. `encoder` is the folder of an encoder. If `fit_ratio` is true,
    the steering ratio of the wheel's log is fitted to the measured motion. Raises InputError if no
    frame can be read, or a log is unusable.
    """
    with run_chain(source, out, READING, Perception(batch=4), encoder) as work:
        results = Results.read(source, work, car, look_ahead=True, fit_ratio=fit_ratio)
        results.doubts += warnings(encoder, "float32", [work / INGEST])
        quality = _measure_quality(source, results, work)
        results.quality = quality
        notes = [*source.drive.notes, *results.lines(quality["comparison"])]
        notes += _quality_lines(source, results, quality)
    files = publish(out, "motion.csv", results, source, car.wheelbase_m, video=video)
    return Outcome(results.columns(), notes, results.doubts, files)


def _measure_quality(source: Source, results: Results, work: Path) -> dict[str, Any]:
    """Return the content of quality.json. Unknown values are None."""
    with DriveReader(work / MOTION, stage="motion") as motion:
        heights_m = motion["road_height_m"]
        bonnet = float(motion.attrs["still"])
    has_road = heights_m > 0
    is_valid = results.table["valid"] > 0
    time_s = results.table["time_s"]
    camera = source.camera
    recorded = dict[str, Any](results.recorded)
    if results.truth.wheel:
        recorded["wheel"] = results.truth.wheel._asdict()
    return {
        "version": version("semantic-steering"),
        "revision": revision(ROOT) or None,
        "source": str(source.path),
        "step_s": _median(np.diff(time_s)),
        "K": camera.K.round(3).tolist(),
        "camera_height_m": camera.height_m if camera.height_known else None,
        "horizon": camera.horizon,
        "road_frames": float(has_road.mean()),
        # Height in metres of the camera over the road, as the encoder's depth shows it.
        "road_height_m": _median(heights_m[has_road]),
        "speed_sigma": _median(results.table["speed_sigma"][is_valid]),
        "bonnet": bonnet,
        "recorded": recorded,
        "comparison": results.compare("measured"),
    }


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None


def _quality_lines(source: Source, results: Results, quality: dict[str, Any]) -> Iterator[str]:
    """Yield notes for the user about the scale, which comes from the road."""
    share = f"{quality['road_frames']:.0%}"
    line = f"road found in {share} of the frames"
    if share != "100%":
        line += "; elsewhere speed stays near a typical car's"
    yield line

    if quality["road_height_m"] and not source.camera.height_known:
        height = f"{quality['road_height_m']:.2f} m above the road"
        advice = "Measure it and pass --camera-height: speed follows it"
        yield f"the encoder's depth puts the camera {height}. {advice}"
    if quality["speed_sigma"] and not results.doubts:
        sigma = f"{quality['speed_sigma']:.0%} (one standard deviation)"
        yield f"speed and curvature may be off by {sigma}"
