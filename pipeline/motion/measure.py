"""Measure the motion of a drive: data/motion/<drive>.h5."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base.summary import Summary
from pipeline.camera.camera import Camera
from pipeline.motion.motion_file import PROBLEMS, STANDSTILL, UNITS, create_motion
from pipeline.motion.odometry import Odometry
from pipeline.motion.rates import smooth_rates
from pipeline.motion.speed import (
    KNOWN_HEIGHT_SIGMA,
    LEAST_MPS,
    UNKNOWN_HEIGHT_SIGMA,
    Speeds,
    filter_speeds,
)
from pipeline.motion.step import MEDIAN_DEVIATION, average_durations, compute_rates
from pipeline.perception.drive_frames import DriveFrames

# Largest acceleration of a car in m/s², when it brakes.
MAX_ACCELERATION_MPS2 = 12.0
# Largest error of a measured speed, as a share of it, for which a step is believed.
MAX_ERROR = 0.25
# Time in seconds after which a speed says nothing about the present one.
FORGET_S = 1.0
# Factor between an estimated speed and the one by depth above which they contradict each other.
CONTRADICTION = 1.5
# Code of a step that no car makes.
NOT_A_CARS = PROBLEMS.index("a motion that is not a car's")
# Problems of frames that are not measured though the car may move.
LOST = [
    code for code, text in enumerate(PROBLEMS) if text not in ("", "no previous frame", *STANDSTILL)
]


def measure_drive(
    path: Path,
    ingest: Path,
    perception: Path,
    *,
    advance: Callable[[int], object] = lambda frames: None,
) -> Summary:
    """Write the motion of each frame relative to the frame before, by visual odometry.

    Only frames with an image are written. Values are causal: they depend on a frame and earlier
    ones only. Those whose name begins with ``smooth_`` depend on later frames, too. Where motion is
    not measured, ``valid`` and the rates are 0, and ``problem`` is the reason. Depth is scaled so
    that the road is as far below the camera as its height, if that is known. `advance` is called
    with the number of frames that are done since the last call. Returns counts and medians for
    :mod:`pipeline.motion.facts`, which are also attributes of the file.
    """
    with (
        DriveFrames(ingest, perception) as frames,
        create_motion(path, drive=frames.drive, params=frames.params) as file,
    ):
        duration_s = average_durations(frames.frame, frames.time_s)
        scale_sigma = KNOWN_HEIGHT_SIGMA if frames.camera.height_known else UNKNOWN_HEIGHT_SIGMA
        columns = _measure_steps(frames, duration_s, advance)
        scatter = _measure_scatter(columns["speed_mps"], _has_scale(columns))
        _remove_jumps(columns, frames.time_s)
        _add_estimates(columns, frames.time_s, duration_s, scale_sigma)

        columns["frame"] = frames.frame
        columns["time_s"] = frames.time_s
        columns["valid"] = _is_measured(columns).astype(np.uint8)
        for name, unit in UNITS.items():
            file.put(name, columns[name], unit)

        summary = _summarise_steps(columns, duration_s, frames.camera)
        summary["scatter"] = scatter
        summary["scale_sigma"] = scale_sigma
        # Factor above which depth must be in another unit; 0 if the height is unknown.
        summary["unit_error"] = frames.unit_error if np.isfinite(frames.unit_error) else 0.0
        file.attrs |= summary
    return summary


def _measure_steps(
    frames: DriveFrames, duration_s: np.ndarray, advance: Callable[[int], object]
) -> dict[str, np.ndarray]:
    """Return the columns of the file with the measured steps: name → [F].

    `duration_s` [F] are the durations of the steps.
    """
    columns = dict[str, np.ndarray]()
    for name in UNITS:
        dtype = np.float64 if name.startswith("smooth_") else np.float32
        columns[name] = np.zeros(len(duration_s), dtype)
    columns["problem"] = np.zeros(len(duration_s), np.uint8)
    columns["T_before_now"] = np.tile(np.eye(4, dtype=np.float32), (len(duration_s), 1, 1))

    odometry = Odometry(frames.camera)
    for row, frame in enumerate(frames):
        step = odometry.measure_step(frame)
        if step:
            # The fields of a step and its rates are columns of these names.
            values = step._asdict() | compute_rates(step.T_before_now, duration_s[row])._asdict()
            for name, value in values.items():
                columns[name][row] = value
        columns["problem"][row] = PROBLEMS.index(odometry.problem)
        columns["road_height_m"][row] = odometry.road.frame_height_m
        advance(1)
    return columns


def _is_measured(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the frames whose motion is measured, bool [F]."""
    return columns["problem"] == 0


def _has_scale(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the measured frames with a road, bool [F]: without one, the scale is unknown."""
    return _is_measured(columns) & (columns["road_height_m"] > 0)


def _remove_jumps(columns: dict[str, np.ndarray], time_s: np.ndarray) -> None:
    """Remove speeds that no car can reach from the one before: they are no measurement."""
    jumps = find_jumps(time_s, columns["speed_mps"], _has_scale(columns))
    columns["problem"][jumps] = NOT_A_CARS
    for name in ("yaw_rate_radps", "speed_mps"):
        columns[name][jumps] = 0


def _add_estimates(
    columns: dict[str, np.ndarray], time_s: np.ndarray, duration_s: np.ndarray, scale_sigma: float
) -> None:
    """Add filtered speeds and smooth rates, and their standard deviations.

    `scale_sigma` is the relative standard deviation of the drive's scale.
    """
    # Ratios of lengths become those of speeds.
    before_s = np.append(np.nan, duration_s[:-1])
    columns["ratio"] *= np.nan_to_num(before_s / duration_s).astype(np.float32)

    # A ratio counts only between two neighbouring steps that are measured. After lost images, the
    # step over the gap is removed, since it is several steps long.
    valid = _is_measured(columns)
    columns["ratio"][~valid] = 0
    columns["ratio"][1:][~valid[:-1]] = 0

    speeds = Speeds(
        time_s=time_s[valid],
        speed_mps=columns["speed_mps"][valid],
        road=columns["road_height_m"][valid] > 0,
        ratio=columns["ratio"][valid],
        ratio_sigma=columns["ratio_sigma"][valid],
    )
    filtered = filter_speeds(speeds)
    smooth = smooth_rates(speeds, columns["yaw_rate_radps"][valid])
    for name, values in smooth._asdict().items():
        columns[f"smooth_{name}"][valid] = values

    # The error of the scale is common to the drive, so no filter over time finds it.
    columns["filtered_mps"][valid] = filtered.speed_mps
    columns["speed_sigma"][valid] = np.hypot(filtered.sigma, scale_sigma)
    columns["smooth_speed_sigma"][valid] = np.hypot(smooth.speed_sigma, scale_sigma)


def find_jumps(time_s: np.ndarray, speed_mps: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the frames, bool [F], whose speed no car can reach from that of an earlier frame.

    It is causal: a frame is compared with the last one before it that is no jump itself.
    """
    jumps = np.zeros(len(time_s), bool)
    last: int | None = None
    for row in np.flatnonzero(valid):
        if last is not None and time_s[row] - time_s[last] < FORGET_S:
            change_mps = abs(speed_mps[row] - speed_mps[last])
            error_mps = MAX_ERROR * max(abs(speed_mps[row]), abs(speed_mps[last]))
            by_car_mps = MAX_ACCELERATION_MPS2 * (time_s[row] - time_s[last])
            jumps[row] = change_mps > by_car_mps + error_mps
        if not jumps[row]:
            last = int(row)
    return jumps


def _summarise_steps(
    columns: dict[str, np.ndarray], duration_s: np.ndarray, camera: Camera
) -> Summary:
    """Return counts and medians of F frames.

    `columns`: name → [F]; `duration_s`: of steps [F].
    """
    valid = _is_measured(columns)
    moving = valid | np.isin(columns["problem"], LOST)
    road = columns["road_height_m"] > 0
    contradictions_s = [
        time_contradiction(columns[name], columns["speed_mps"], _has_scale(columns), duration_s)
        for name in ("filtered_mps", "smooth_speed_mps")
    ]
    length_m = np.linalg.norm(columns["T_before_now"][:, :3, 3], axis=1)
    return {
        "frames": len(valid),
        "valid": int(valid.sum()),
        "moving": int(moving.sum()),
        "backwards": int((columns["speed_mps"] < 0).sum()),
        "step_s": _median_or_zero(duration_s[moving]),
        # Without a road, the scale of a step is unknown.
        "step_m": _median_or_zero(length_m[valid & road]),
        "road_frames": int(road.sum()),
        "moving_road_frames": int((moving & road).sum()),
        "road_height_m": _median_or_zero(columns["road_height_m"][road]),
        "camera_height_m": camera.height_m,
        "scaled": int(camera.height_known),
        "contradiction_s": max(contradictions_s),
    }


def time_contradiction(
    estimated_mps: np.ndarray, speed_mps: np.ndarray, valid: np.ndarray, duration_s: np.ndarray
) -> float:
    """Return the longest time in seconds over which estimated speeds contradict those by depth.

    All are [F]. Only frames that are `valid` count: others neither add to the time nor end it.
    """
    estimated = np.log(np.maximum(np.abs(estimated_mps), LEAST_MPS))
    by_depth = np.log(np.maximum(np.abs(speed_mps), LEAST_MPS))
    contradicts = np.abs(estimated - by_depth) > math.log(CONTRADICTION)
    longest_s = 0.0
    current_s = 0.0
    for row in np.flatnonzero(valid):
        current_s = current_s + float(duration_s[row]) if contradicts[row] else 0.0
        longest_s = max(longest_s, current_s)
    return longest_s


def _measure_scatter(speed_mps: np.ndarray, valid: np.ndarray) -> float:
    """Return the typical ratio of successive speeds, less 1; it is robust to few large ones."""
    both = valid[1:] & valid[:-1]
    magnitude_mps = np.maximum(np.abs(speed_mps), LEAST_MPS)
    changes = np.abs(np.diff(np.log(magnitude_mps)))[both]
    return float(np.expm1(_median_or_zero(changes) / MEDIAN_DEVIATION))


def _median_or_zero(values: np.ndarray) -> float:
    """Return the median of values [N]; 0 if there are none."""
    if not len(values):
        return 0.0
    return float(np.median(values))
