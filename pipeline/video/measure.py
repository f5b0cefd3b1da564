"""Measure the motion of a car from the frames of a source: a CSV file, a video, the track, and their quality."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.labels.label import Car
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception
from pipeline.video.pictures import draw_track, write_overlay
from pipeline.video.results import Logs, Results
from pipeline.video.source import MOTION, ROTATE, Source, publish, run_chain, work_folder

CAMERAS = [2, 0, 3, 1]  # of a KITTI drive, the first one with images
READING = Reading(image_size=(192, 640), cameras=CAMERAS, lidar=False, on_damaged="skip")  # as the encoder was trained
MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain
FOCAL_TOLERANCE, FOCAL_SIGMAS = 0.18, 5.0  # smaller deviations are not reported: of the logarithm, and in sigmas
MAX_SPREAD = 0.15  # of the road's heights
MIN_DRIVEN_MPS = 1.0  # of frames whose speeds are compared
# On its side, a camera pitches where the car turns. On KITTI's drives, pitch changes by up to 3.4 degrees in 5 s.
MAX_PITCH_RAD, MAX_STEP_PITCH_RAD, PITCH_S = math.radians(20.0), math.radians(3.0), 5.0


def measure(
    source: Source, out: Path | None, encoder: Path, car: Car, logs: Logs, *, video: bool, visible: bool
) -> tuple[Results, dict[str, Any], list[Path]]:
    """Write motion.csv, track.png, quality.json and overlay.mp4; return results, quality and files.

    Args:
        source: frames.
        out: new or empty folder; None: out/NAME.
        encoder: folder of an encoder.
        car: for the steering angle.
        logs: of what was driven.
        video: write overlay.mp4.
        visible: show a progress bar.
    Raises:
        InputError: `out` is not free, no frame can be read, the images seem to be rotated, or a log is unusable.
    """
    work = work_folder(out, source, encoder)
    run_chain(source, work, READING, Perception(batch=4), encoder, visible=visible)
    results = Results.read(source, work, car, logs, look_ahead=True)
    with DriveReader(work / MOTION, stage="motion") as motion:
        _refuse_rotated(motion, source.path)
        quality = _quality(motion, results, source)
    results.write_csv(work / "new/motion.csv")
    store.write_json(work / "new/quality.json", quality)
    draw_track(work / "new/track.png", results)
    if video:
        write_overlay(work / "new/overlay.mp4", source, results, car.wheelbase_m)
    return results, quality, publish(work)


def _refuse_rotated(motion: DriveReader, path: Path) -> None:
    """Raise InputError if pitch changes by more than MAX_PITCH_RAD in PITCH_S.

    A step counts at most MAX_STEP_PITCH_RAD, so that a single wrong one is not enough.
    """
    valid = motion["valid"].astype(bool)
    steps = np.arcsin(np.clip(motion["T_before"][valid, 2, 1], -1, 1)).clip(-MAX_STEP_PITCH_RAD, MAX_STEP_PITCH_RAD)
    time_s, pitch = motion.time_s[valid], np.concatenate([[0.0], np.cumsum(steps)])
    first = np.searchsorted(time_s, time_s - PITCH_S)
    turned = np.abs(pitch[1:] - pitch[first])
    if len(turned) and turned.max() > MAX_PITCH_RAD:
        pitched = f"the camera's pitch changes by {math.degrees(turned.max()):.0f} degrees in {PITCH_S:g} s"
        raise InputError(f"{pitched}. Is it rotated by 90 degrees?", path, ROTATE)


def _quality(motion: DriveReader, results: Results, source: Source) -> dict[str, Any]:
    """Return the content of quality.json; None where unknown. Heights of the road are by the encoder's depth."""
    heights_m, (gradient, information) = motion["road_height_m"], motion.attrs["focal"]
    known, sigmas = heights_m[heights_m > 0], results.table["speed_sigma"][results.table["valid"] > 0]
    speed_mps, driven_mps = results.table["speed_mps"], results.truth.driven_mps
    used = np.isfinite(speed_mps) & (driven_mps >= MIN_DRIVEN_MPS)
    summary: dict[str, Any] = {
        "K": source.camera.K.tolist(),
        "camera_height_m": source.camera.height_m if source.height_known else None,
        "horizon": source.camera.horizon,
        "road_frames": float((heights_m > 0).mean()),
        "road_height_m": float(np.median(known)) if len(known) else None,
        "road_height_spread": float(known.std() / known.mean()) if len(known) else None,
        "speed_sigma": float(np.median(sigmas)) if len(sigmas) else None,
        "speed_ratio": float(speed_mps[used].sum() / driven_mps[used].sum()) if used.any() else None,
        "pitch_deg": math.degrees(math.atan(motion.attrs["slope"])),
        "focal_ratio": math.exp(float(np.clip(-gradient / information, -1, 1))) if information > 0 else None,
        "focal_sigma": float(information**-0.5) if information > 0 else None,
    }
    return summary | {"remarks": _remarks(summary, results.truth.name)}


def _remarks(summary: dict[str, Any], truth: str) -> list[str]:
    """Return warnings about the scale and the focal length, or why there are none."""
    height_m, road_m, spread = (summary[key] for key in ("camera_height_m", "road_height_m", "road_height_spread"))
    if road_m is None or summary["road_frames"] < MIN_ROAD:
        scale = f"road found in {summary['road_frames']:.0%} of the frames, so speed stays near a typical car's"
    elif height_m is None:
        scale = (
            f"the encoder's depth, which puts the camera {road_m:.2f} m above the road (spread {spread:.0%}). Measure "
            "it and pass --camera-height: speed is proportional to it"
        )
    else:
        scale = f"the camera's height of {height_m:.2f} m over the road (spread {spread:.0%})"
        scale += ", uncertain" if spread > MAX_SPREAD else ""
    remarks = [f"scale: {scale}"]
    if summary["speed_sigma"] is not None:
        remarks.append(f"speed and curvature may be off by {summary['speed_sigma']:.0%} (one standard deviation)")
    if summary["speed_ratio"] is not None:
        remarks.append(f"speed is {summary['speed_ratio']:.2f} times the one recorded in {truth}")
    ratio, sigma = summary["focal_ratio"], summary["focal_sigma"]
    if ratio is None or sigma > FOCAL_TOLERANCE / 2:
        remarks.append("focal length: too few turns to check it")
    elif abs(math.log(ratio)) > max(FOCAL_TOLERANCE, FOCAL_SIGMAS * sigma):
        direction = "short (pass a smaller --fov)" if ratio > 1 else "long (pass a larger --fov)"
        remarks.append(f"focal length: turns of the camera show that it is too {direction}")
    else:
        remarks.append("focal length: agrees with the turns of the camera")
    return remarks
