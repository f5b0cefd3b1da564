"""Measure the motion of a car from the frames of a source: a CSV file, a video, the track, and their quality."""

import math
from collections import deque
from collections.abc import Generator
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.labels.label import Car
from pipeline.live.chain import Chain, FrameState
from pipeline.live.course import add_courses
from pipeline.live.results import MEASURED_FILES, MOTION, POSES, QUALITY, TRACK, Results, result_folder, write_frames
from pipeline.live.source import ROTATE, Source
from pipeline.live.track import PoseFormat, draw_track, pose_lines
from pipeline.motion.visual import Odometry
from pipeline.settings.perception import Perception
from pipeline.train.prefetch import prefetch

SIZE = (192, 640)  # of images, as the depth network was trained
FOCAL_TOLERANCE, FOCAL_SIGMAS = 0.18, 5.0  # smaller deviations are not reported: of the logarithm, and in sigmas
MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain
MAX_SPREAD = 0.15  # of the road's heights
# On its side, a camera pitches where the car turns. On KITTI's drives, pitch changes by up to 3.4 degrees in 5 s.
MAX_PITCH_RAD, MAX_STEP_PITCH_RAD, PITCH_S = math.radians(20.0), math.radians(3.0), 5.0


def measure(
    source: Source,
    encoder: Path,
    car: Car,
    out: Path,
    max_frames: int | None,
    poses: PoseFormat | None,
    *,
    video: bool,
    visible: bool,
) -> tuple[Results, dict[str, Any]]:
    """Write motion.csv, track.png, quality.json, poses.txt and the video to `out`; return results and quality.

    Args:
        encoder: folder of an encoder.
        max_frames: measure only these first frames; None: all.
        poses: format of poses.txt; None: not written.
        visible: show a progress bar.
    Raises:
        InputError: the encoder has no network, no frame can be read, or the images seem to be rotated.
    """
    camera, settings = source.cropped.scaled(SIZE), Perception(batch=1)
    chain = Chain(camera, source.name, encoder, {"visual"}, settings, road_scale=source.height_known)
    assert chain.odometry
    if max_frames:
        source.count = min(max_frames, source.count or max_frames)
    with closing(_first(source.frames, max_frames)) as frames, result_folder(out, *MEASURED_FILES) as folder:
        upright = _refuse_rotated(prefetch(chain.run(frames), 1), source.path)
        courses = add_courses(upright, car, smooth=True, height_known=source.height_known)
        results = write_frames(courses, folder / MOTION, source, car, warm_up=1, video=video, visible=visible)
        quality = _quality(results, chain.odometry, source)
        store.write_json(folder / QUALITY, quality)
        draw_track(folder / TRACK, source.name, results)
        if poses:
            (folder / POSES).write_text("".join(f"{line}\n" for line in pose_lines(results, poses)), encoding="ascii")
    return results, quality


def _first(frames: Generator[FrameState], count: int | None) -> Generator[FrameState]:
    with closing(frames):
        yield from islice(frames, count)


def _refuse_rotated(frames: Generator[FrameState], path: Path) -> Generator[FrameState]:
    """Yield the frames; raise InputError when pitch has changed by more than MAX_PITCH_RAD in PITCH_S.

    A step counts at most MAX_STEP_PITCH_RAD, so that a single wrong one is not enough. Closes `frames`.
    """
    steps: deque[tuple[float, float]] = deque()  # time and pitch
    with closing(frames):
        for frame in frames:
            if frame.estimate:
                pitch_rad = math.asin(float(np.clip(frame.estimate.step.T_before[2, 1], -1, 1)))
                steps.append((frame.time_s, min(max(pitch_rad, -MAX_STEP_PITCH_RAD), MAX_STEP_PITCH_RAD)))
            while steps and steps[0][0] < frame.time_s - PITCH_S:
                steps.popleft()
            if abs(pitched_rad := sum(pitch_rad for _, pitch_rad in steps)) > MAX_PITCH_RAD:
                pitched = f"the camera's pitch changes by {math.degrees(abs(pitched_rad)):.0f} degrees in {PITCH_S:g} s"
                raise InputError(f"{pitched}. Is it rotated by 90 degrees?", path, ROTATE)
            yield frame


def _quality(results: Results, odometry: Odometry, source: Source) -> dict[str, Any]:
    """Return the content of quality.json; None where unknown. Heights of the road are by the encoder's depth."""
    heights_m = np.array(results.road_heights_m)
    known = heights_m[np.isfinite(heights_m)]
    gradient, information = odometry.focal
    sigmas = [course.speed_sigma for _, course in results.courses]
    summary: dict[str, Any] = {
        "K": source.camera.K.tolist(),
        "distortion": source.distortion or None,
        "camera_height_m": source.camera.height_m if source.height_known else None,
        "road_frames": float(np.isfinite(heights_m).mean()),
        "road_height_m": float(np.median(known)) if len(known) else None,
        "road_height_spread": float(known.std() / known.mean()) if len(known) else None,
        "speed_sigma": float(np.median(sigmas)) if sigmas else None,
        "speed_ratio": results.speed_ratio(),
        "pitch_deg": math.degrees(math.atan(odometry.road.slope)),
        "focal_ratio": math.exp(float(np.clip(-gradient / information, -1, 1))) if information > 0 else None,
        "focal_sigma": float(information**-0.5) if information > 0 else None,
    }
    return summary | {"remarks": _remarks(summary, source.truth)}


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
