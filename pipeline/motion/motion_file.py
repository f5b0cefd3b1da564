"""Measure the motion of a drive: data/motion/<drive>.h5."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base.runner import Summary
from pipeline.base.store import DriveWriter
from pipeline.camera.camera import Camera, DriveFrames
from pipeline.motion.odometry import Odometry
from pipeline.motion.roll import EVERY, Roll
from pipeline.motion.step import LEAST_NOISE, PROBLEMS, STANDSTILL, durations, filter_speed, rates
from pipeline.motion.still import lowest_share

# Least share of the class road, in front of the car, in a frame whose classes show a road.
ROAD_BY_CLASS = 0.5
# Problems of frames that are not measured though the car may move.
LOST = [
    code for code, text in enumerate(PROBLEMS) if text not in ("", "no previous frame", *STANDSTILL)
]
_CODES = ", ".join(f"{code} = {text}" for code, text in enumerate(PROBLEMS) if code)
# Columns of the file, in order, and their units.
UNITS = {
    "yaw_rate_radps": "rad/s, left positive",
    "speed_mps": "m/s, forward positive",
    "inliers": "",
    "residual": "px",
    "scale": "depth was multiplied by it",
    "T_before_now": "m",
    "road_height_m": "m below the camera in the encoder's depth, 0 = no road found",
    "still": "share of the lowest row that shows no street",
    "problem": f"0 = measured; {_CODES}",
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

    All values are causal: they depend on a frame and earlier ones only. Where motion is not
    measured, ``valid`` and the rates are 0, and ``problem`` is the reason. Depth is scaled so that
    the road is as far below the camera as its height, if that is known. `advance` is called with
    the number of frames that are done since the last call. Returns counts and medians for
    :mod:`pipeline.motion.doubts`, which are also attributes of the file.
    """
    with (
        DriveFrames(ingest, perception) as frames,
        DriveWriter(path, stage="motion", drive=frames.drive, params=frames.params) as file,
    ):
        duration_s = durations(frames.frame, frames.time_s)
        columns = _empty_columns(len(frames.frame))
        road_class = np.zeros(len(frames.frame))

        # Measure frame after frame.
        odometry = Odometry(frames.camera)
        roll = Roll(frames.camera)
        for row, frame in enumerate(frames):
            step = odometry.step(frame)
            if step:
                values = step._asdict() | rates(step.T_before_now, duration_s[row])._asdict()
                for name, value in values.items():
                    columns[name][row] = value
            columns["problem"][row] = PROBLEMS.index(odometry.problem)
            columns["road_height_m"][row] = odometry.road.frame_height_m
            columns["still"][row] = odometry.still.mask[-1].mean()
            road_class[row] = odometry.road_class
            if row % EVERY == 0:
                roll.add(frame.image)
            advance(1)

        # Filter the measured speeds: without a road, their scale is uncertain.
        valid = columns["problem"] == 0
        road = columns["road_height_m"] > 0
        filtered_mps, speed_sigma = filter_speed(
            frames.time_s[valid],
            columns["speed_mps"][valid],
            road[valid],
            np.full(valid.sum(), LEAST_NOISE),
        )
        columns["filtered_mps"][valid] = filtered_mps
        columns["speed_sigma"][valid] = speed_sigma

        file.put("frame", frames.frame)
        file.put("time_s", frames.time_s, "s")
        file.put("valid", valid.astype(np.uint8))
        for name, unit in UNITS.items():
            file.put(name, columns[name], unit)

        summary = _summarise(columns, road_class, duration_s, frames.camera)
        summary["roll_deg"] = roll.degrees()
        summary["unit_error"] = frames.unit_error if np.isfinite(frames.unit_error) else 0.0
        file.attrs |= summary
    return summary


def _empty_columns(count: int) -> dict[str, np.ndarray]:
    """Return the columns of a number of frames without motion."""
    columns = {name: np.zeros(count, np.float32) for name in UNITS}
    columns["inliers"] = np.zeros(count, np.int32)
    columns["problem"] = np.zeros(count, np.uint8)
    columns["scale"] = np.ones(count, np.float32)
    columns["T_before_now"] = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1))
    return columns


def _summarise(
    columns: dict[str, np.ndarray], road_class: np.ndarray, duration_s: np.ndarray, camera: Camera
) -> Summary:
    """Return counts and medians of F frames.

    `columns`: name → [F]; `road_class`: share of the class road [F]; `duration_s`: of steps [F].
    """
    valid = columns["problem"] == 0
    moving = valid | np.isin(columns["problem"], LOST)
    length_m = np.linalg.norm(columns["T_before_now"][:, :3, 3], axis=1)

    # The class road is judged where depth shows one.
    road = columns["road_height_m"] > 0
    share_on_road = road_class[road & np.isfinite(road_class)]
    return {
        "frames": len(valid),
        "valid": int(valid.sum()),
        "moving": int(moving.sum()),
        "step_s": _median(duration_s[moving]),
        # Without a road, the scale of a step is unknown.
        "step_m": _median(length_m[valid & road]),
        "still": lowest_share(columns["still"], valid),
        "road_frames": int(road.sum()),
        "height_ratio": _median(columns["road_height_m"][road]) / camera.height_m,
        "road_class": float(share_on_road.mean()) if len(share_on_road) else 1.0,
        "road_class_frames": int((road_class > ROAD_BY_CLASS).sum()),
        "scaled": int(camera.height_known),
    }


def _median(values: np.ndarray) -> float:
    """Return the median of values [N]; 0 if there are none."""
    if not len(values):
        return 0.0
    return float(np.median(values))
