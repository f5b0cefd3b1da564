"""Measure the motion of a car from the frames of a source: a CSV file, a video, the track, and
their quality.
"""

from pathlib import Path

import numpy as np

from pipeline.base.store import DriveReader
from pipeline.ingest.settings import Reading
from pipeline.labels.label import Car
from pipeline.perception.perceive import warnings
from pipeline.perception.settings import Perception
from steer.chain import INGEST, MOTION, Source, run_chain
from steer.outcome import Outcome, Results
from steer.pictures import publish

# As the encoder was trained; of a KITTI drive, the first camera with images.
READING = Reading(image_size=(192, 640), cameras=[2, 0, 3, 1], lidar=False, on_damaged="skip")


def measure(source: Source, out: Path | None, encoder: Path, car: Car, *, video: bool) -> Outcome:
    """Write motion.csv, track.png, quality.json and, if `video`, overlay.mp4 to a free folder
    `out`; None: no files.

    `encoder`: a folder. Raises InputError if no frame can be read, or a log is unusable.
    """
    with run_chain(source, out, READING, Perception(batch=4), encoder) as work:
        results = Results.read(source, work, car, look_ahead=True)
        results.doubts += warnings(encoder, "float32", [work / INGEST])
        comparison = results.compare("measured")
        with DriveReader(work / MOTION, stage="motion") as motion:
            heights_m, bonnet = motion["road_height_m"], float(motion.attrs["still"])
        known, sigmas = (
            heights_m[heights_m > 0],
            results.table["speed_sigma"][results.table["valid"] > 0],
        )
        # None where unknown; the road's height is by the encoder's depth
        quality = results.quality = {
            "horizon": source.camera.horizon,
            "road_frames": float((heights_m > 0).mean()),
            "road_height_m": float(np.median(known)) if len(known) else None,
            "speed_sigma": float(np.median(sigmas)) if len(sigmas) else None,
            "bonnet": bonnet,
            "recorded": results.agreement.content(),
            "comparison": comparison,
        }
        share = f"{quality['road_frames']:.0%}"
        elsewhere = "" if share == "100%" else "; elsewhere speed stays near a typical car's"
        lines = [*results.lines(comparison), f"road found in {share} of the frames{elsewhere}"]
        if quality["road_height_m"] and not source.camera.height_known:
            height = f"{quality['road_height_m']:.2f} m above the road. Measure it"
            lines.append(
                f"the encoder's depth puts the camera {height} and pass --camera-height: speed "
                "follows it"
            )
        if quality["speed_sigma"] and not results.doubts:
            lines.append(
                f"speed and curvature may be off by {quality['speed_sigma']:.0%} (one standard "
                "deviation)"
            )
    files = publish(out, "motion.csv", results, source, car.wheelbase_m, video=video)
    return Outcome(results.columns(), [*source.drive.notes, *lines], results.doubts, files)
