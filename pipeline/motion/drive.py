"""Measure the motion of a drive: data/motion/<drive>.h5."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import DriveFrames
from pipeline.motion.step import LEAST_NOISE, PROBLEMS, durations, filter_speed, rates
from pipeline.motion.still import lowest_share
from pipeline.motion.visual import Odometry

ROAD_FRAMES = 50  # that tell a unit
UNITS = {
    "yaw_rate_radps": "rad/s, left positive",
    "speed_mps": "m/s, forward positive",
    "inliers": "",
    "residual": "px",
    "scale": "depth was multiplied by it",
    "T_before_now": "m",
    "road_height_m": "m below the camera in the encoder's depth, 0 = no road found",
    "still": "share of the lowest row that shows no street",
    "problem": f"0 = measured; {', '.join(f'{code} = {text}' for code, text in enumerate(PROBLEMS) if code)}",
    "filtered_mps": "m/s, speed_mps after a causal filter of the error of depth's scale",
    "speed_sigma": "relative standard deviation of filtered_mps",
}


def measure_drive(
    path: Path,
    ingest: Path,
    perception: Path,
    *,
    advance: Callable[[int], object] = lambda frames: None,
) -> Summary:
    """Write the motion of each frame with an image since the previous frame, by visual odometry.

    All values are causal: they depend on a frame and earlier ones only. Where motion is not measured, ``valid`` and the
    rates are 0, and ``problem`` is the reason. Depth is scaled so that the road is as far below the camera as its
    height, if that is known. `advance` is called with the number of frames that are done since the last call.
    """
    with (
        DriveFrames(ingest, perception) as frames,
        DriveWriter(path, stage="motion", drive=frames.drive, params=frames.params) as file,
    ):
        count, odometry = len(frames.frame), Odometry(frames.camera)
        columns = dict(zip(UNITS, np.zeros((len(UNITS), count), np.float32), strict=True))
        columns |= {"inliers": np.zeros(count, np.int32), "problem": np.zeros(count, np.uint8)}
        columns |= {"scale": np.ones(count, np.float32), "T_before_now": np.tile(np.eye(4, dtype="f4"), (count, 1, 1))}
        for row, (frame, duration_s) in enumerate(zip(frames, durations(frames.frame, frames.time_s), strict=True)):
            step = odometry.step(frame)
            values = {"problem": PROBLEMS.index(odometry.problem), "road_height_m": odometry.road.frame_height_m}
            values["still"] = odometry.still.mask[-1].mean()
            if step:
                values |= dict(zip(("yaw_rate_radps", "speed_mps"), rates(step.T_before_now, duration_s), strict=True))
                values |= step._asdict()
            for name, value in values.items():
                columns[name][row] = value
            advance(1)
        valid, road = columns["problem"] == 0, columns["road_height_m"] > 0
        measured = frames.time_s[valid], columns["speed_mps"][valid], road[valid]
        filtered = filter_speed(*measured, np.full(valid.sum(), LEAST_NOISE))
        columns["filtered_mps"][valid], columns["speed_sigma"][valid] = filtered

        file.put("frame", frames.frame)
        file.put("time_s", frames.time_s, "s")
        file.put("valid", valid.astype(np.uint8))
        for name, unit in UNITS.items():
            file.put(name, columns[name], unit)
        _check_unit(columns["road_height_m"][road], frames.camera.height_m, frames.unit_error)
    still = lowest_share(columns["still"], valid)
    counts = {"frames": count, "valid": int(valid.sum()), "road_frames": int(road.sum())}
    return counts | {"still": still, "scaled": int(frames.camera.height_known)}


def _check_unit(heights_m: np.ndarray, camera_m: float, factor: float) -> None:
    """Raise InputError if the road of many frames is `factor` times farther from or nearer to the camera than known."""
    height_m = float(np.median(heights_m)) if len(heights_m) >= ROAD_FRAMES else camera_m
    if not 1 / factor < height_m / camera_m < factor:
        problem = (
            f"by depth, the road is {height_m:.2f} m below a camera {camera_m:.2f} m above it: depth in other units?"
        )
        raise InputError(problem, fix="PNG files of backbone: precomputed have metres × 256. Or correct the height")
