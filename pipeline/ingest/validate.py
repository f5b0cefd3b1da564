"""Validate what a dataset's file returns, while stage ingest reads it.

Later stages trust an ingest file, so anything of another type, shape, order or unit than
pipeline/ingest/drive.py says raises InputError here. Frames are checked one by one, so that only
one of them is in memory.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from statistics import median_low
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError, closest
from pipeline.base.params import RATE_TOLERANCE
from pipeline.base.summary import DOUBT
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.classes import COUNT, VOID
from pipeline.camera.images import DEPTH_UNITS_PER_M, MAX_UNITS, format_size
from pipeline.camera.pinhole import check_pinhole
from pipeline.ingest.clocks import is_gap
from pipeline.ingest.columns import list_fault
from pipeline.ingest.drive import LIMITS, Drive
from pipeline.ingest.packets import COLUMNS, extract_motion

# Least plausible median step between frames in seconds.
LEAST_STEP_S = 0.005
# Largest plausible median step between frames in seconds. Times in milliseconds exceed it.
LONGEST_STEP_S = 2.0
# Ratio to the median step above which a step between neighbouring numbers is noted. A lost image
# makes it 2.
LONG_STEP = 1.5
# Largest number of a frame, as files store int32.
LAST_NUMBER = int(np.iinfo(np.int32).max)
# Largest depth in metres that files store.
MAX_DEPTH_M = MAX_UNITS / DEPTH_UNITS_PER_M
# Advice for depth of another unit.
_DEPTH = "Convert it to metres, 0 where unknown and in the sky"


class _Pixels(NamedTuple):
    """The type of a field of Frame that has a value for each pixel."""

    dtype: type
    channels: tuple[int, ...]
    expected: str


_PIXELS = {
    "image": _Pixels(np.uint8, (3,), "RGB uint8 [H,W,3]"),
    "depth_m": _Pixels(np.floating, (), "float [H,W] in metres"),
    "cls": _Pixels(np.uint8, (), "trainIds uint8 [H,W]"),
}


def check_fingerprint(facts: object) -> None:
    """Raise InputError unless the facts of a drive's fingerprint are JSON-able."""
    try:
        json.dumps(facts)
    except (TypeError, ValueError) as error:
        fix = "Return a list of texts, ints and floats"
        raise InputError(f"fingerprint is not JSON-able ({error})", fix=fix) from error


def check_drive(drive: object) -> None:
    """Raise InputError if the fields of a drive or of its camera have other types."""
    if not isinstance(drive, Drive):
        raise InputError(f"open_drive returned {_describe(drive)}, expected a Drive")
    _check_type(drive.camera, Camera, "Drive.camera")
    _check_type(drive.frames, Callable, "Drive.frames")
    _check_type(drive.values, Mapping, "Drive.values")
    _check_type(drive.notes, list, "Drive.notes")
    _check_type(drive.dataset, str, "Drive.dataset")
    _check_type(drive.damaged, list, "Drive.damaged")

    camera = drive.camera
    size = camera.size
    if not isinstance(size, tuple) or len(size) != 2 or not all(_is_int(side) for side in size):
        raise InputError(f"Camera.size is {size!r}, expected a tuple of two ints (H, W)")
    _check_matrix(camera.K, (3, 3), "Camera.K")
    if camera.T_cam_velo is not None:
        _check_matrix(camera.T_cam_velo, (4, 4), "Camera.T_cam_velo")
    if not _is_finite(camera.height_m) or camera.height_m <= 0:
        raise InputError(f"Camera.height_m is {camera.height_m!r}, expected metres above 0")
    if camera.horizon is not None and not _is_finite(camera.horizon):
        raise InputError(f"Camera.horizon is {camera.horizon!r}, expected a row of the image")


def check_values(values: Mapping[str, Any]) -> dict[str, dict[int, Any]]:
    """Return name → frame number → value, with the motion in packets; NaN where it is unknown.

    Values are floats, and packets float64 [30]. None is unknown, too. Raises InputError.
    """
    numbers = dict[str, dict[int, Any]]()
    faults = list[str]()
    for name, by_number in values.items():
        if name not in LIMITS:
            problem = f"Drive.values has the unknown name {name}: {closest(name, [*LIMITS])}"
            raise InputError(problem)
        _check_type(by_number, Mapping, f"Drive.values[{name!r}]")
        keys = [key for key in by_number if not _is_int(key)]
        if keys:
            problem = f"{name} has {len(keys)} keys that are not ints, such as {keys[0]!r:.40}"
            raise InputError(problem, "Drive.values", "Map the number of each frame to its value")
        numbers[name], wrong = _to_numbers(name, by_number)
        expected = f"a packet of {len(COLUMNS)} numbers" if name == "oxts" else "a number"
        faults += list_fault(wrong, f"is not {expected}", "frame")

    numbers = extract_motion(numbers.get("oxts", {})) | numbers
    for name, limit in LIMITS.items():
        if name == "oxts":
            continue
        column = pd.Series(numbers.get(name, {}), name=name, dtype=float)
        problem = f"is implausible (limit ±{limit:g})"
        faults += list_fault(column[column.abs() > limit], problem, "frame")
    if bool(numbers["speed_mps"]) != bool(numbers["yaw_rate_radps"]):
        faults.append("speed_mps and yaw_rate_radps need each other (NaN: unknown)")
    if faults:
        fix = "Values are in rad, m/s and rad/s, left positive"
        raise InputError("; ".join(faults), "Drive.values", fix)
    return numbers


def _to_numbers(name: str, by_number: Mapping[int, Any]) -> tuple[dict[int, Any], pd.Series]:
    """Return frame number → value as a float, or a packet of oxts, and the values that are none."""
    numbers = {}
    wrong = {}
    for number, value in by_number.items():
        converted = _to_packet(value) if name == "oxts" else _to_float(value)
        if converted is None:
            wrong[number] = value
        else:
            numbers[int(number)] = converted
    return numbers, pd.Series(wrong, name=name, dtype=object)


def _to_float(value: Any) -> float | None:
    """Return a number as a float. Return NaN if it is unknown, and None if it is not a number."""
    if value is None or value is pd.NA:
        return float("nan")
    return float(value) if _is_real(value) else None


def _to_packet(value: object) -> np.ndarray | None:
    """Return a packet as float64 [30], NaN if it is unknown, or None for what is no packet."""
    if value is None:
        return np.full(len(COLUMNS), np.nan)
    try:
        packet = np.asarray(value)
    except ValueError:  # of sequences of different lengths
        return None
    if packet.shape != (len(COLUMNS),) or packet.dtype.kind not in "iuf":
        return None
    return packet.astype(np.float64)


def check_frames(frames: object) -> Iterator[Frame]:
    """Yield frames, each after a check of its number and time, which ascend. Raises InputError."""
    if not isinstance(frames, Iterable):
        raise InputError(f"Drive.frames() returned {_describe(frames)}, expected an Iterator")
    before = None
    for frame in frames:
        _check_frame(frame, before)
        before = (frame.number, frame.time_s)
        yield frame


def _check_frame(frame: object, before: tuple[int, float] | None) -> None:
    """Raise InputError unless a frame has a number and a time above those `before` it."""
    if not isinstance(frame, Frame):
        raise InputError(f"Drive.frames() yielded {_describe(frame)}, expected a Frame")
    number = frame.number
    time_s = frame.time_s
    if not _is_int(number) or not 0 <= number <= LAST_NUMBER:
        expected = f"expected an int from 0 to {LAST_NUMBER}"
        raise InputError(f"a frame has the number {number!r:.40}, {expected}")
    if not _is_finite(time_s):
        raise InputError(f"frame {number} has the time {time_s!r:.40}, expected seconds")
    if before and number <= before[0]:
        problem = f"frame {number} follows frame {before[0]}: numbers do not ascend"
        raise InputError(problem, fix="Sort the frames by number, and give each its own")
    if before and time_s <= before[1]:
        problem = f"time does not ascend: {before[1]} s in frame {before[0]}, {time_s} s in frame"
        raise InputError(f"{problem} {number}", fix="Sort the frames by time, and correct it")


def check_fields(frame: Frame, camera: Camera) -> None:
    """Raise InputError if a frame that was read has fields of other types, sizes or values.

    Depth that is NaN is unknown, and becomes 0.
    """
    for name, kind in _PIXELS.items():
        pixels = getattr(frame, name)
        if pixels is not None:
            _check_pixels(pixels, kind, f"{name} of frame {frame.number}", camera)
    # If images have another size than the camera, K may be right.
    check_pinhole(camera.K, camera.size, "Camera.K")
    if frame.depth_m is not None:
        frame.depth_m = _check_depth(frame.depth_m, f"depth_m of frame {frame.number}")
    if frame.cls is not None:
        wrong = frame.cls[(frame.cls >= COUNT) & (frame.cls != VOID)]
        if wrong.size:
            problem = f"cls of frame {frame.number} has class {wrong[0]}"
            expected = f"expected trainIds, 0 to {COUNT - 1} or {VOID}"
            raise InputError(f"{problem}, {expected}", fix="Map other numbers to trainIds")
    if frame.scan is not None:
        _check_scan(frame.scan, f"scan of frame {frame.number}", camera)


def _check_pixels(pixels: Any, kind: _Pixels, title: str, camera: Camera) -> None:
    """Raise InputError for pixels of another type, or of another size than the camera's.

    The crop around the horizon is computed for the camera's size.
    """
    is_array = isinstance(pixels, np.ndarray) and pixels.ndim >= 2
    if (
        not is_array
        or not np.issubdtype(pixels.dtype, kind.dtype)
        or pixels.shape[2:] != kind.channels
    ):
        raise InputError(f"{title} is {_describe(pixels)}, expected {kind.expected}")
    if pixels.shape[:2] != camera.size:
        problem = f"{title} has {format_size(pixels.shape)} pixels"
        expected = f"expected {format_size(camera.size)}, the size of Drive.camera"
        fix = "Give the camera the size (H, W) of the complete images, and K for this size"
        raise InputError(f"{problem}, {expected}", fix=fix)


def _check_depth(depth_m: np.ndarray, title: str) -> np.ndarray:
    """Return depth [H,W] with 0 where it is NaN. Raise InputError for depth that is no distance."""
    # Files store multiples of 1/256 m, up to 256 m: float16 has neither.
    depth_m = depth_m.astype(np.float32, copy=False)
    unknown = np.isnan(depth_m)
    if unknown.any():
        depth_m = np.where(unknown, 0, depth_m)
    if (depth_m < 0).any() or np.isinf(depth_m).any():
        raise InputError(f"{title} is negative or infinite", fix=_DEPTH)
    # Few pixels are beyond what files store. In millimetres, nearly all are.
    known = depth_m[depth_m > 0]
    if known.size and np.mean(known > MAX_DEPTH_M) > 0.5:
        problem = f"{title} has a median of {np.median(known):g} (limit {MAX_DEPTH_M:.0f} m)"
        raise InputError(problem, fix=_DEPTH)
    return depth_m


def _check_scan(scan: Any, title: str, camera: Camera) -> None:
    """Raise InputError for a scan of another type, or without a calibration of the scanner."""
    expected = "float32 [P,4]: x, y, z in metres, reflectance"
    is_scan = isinstance(scan, np.ndarray) and scan.dtype == np.float32
    if not is_scan or scan.ndim != 2 or scan.shape[1] != 4:
        raise InputError(f"{title} is {_describe(scan)}, expected {expected}")
    reflectance = scan[:, 3]
    if not np.isfinite(scan).all() or (reflectance < 0).any() or (reflectance > 1).any():
        problem = f"{title} has values that are not finite, or reflectance beyond 0 to 1"
        raise InputError(problem)
    if camera.T_cam_velo is None:
        raise InputError(f"{title} needs the scanner's calibration, Camera.T_cam_velo")


def check_steps(time_s: np.ndarray) -> float | None:
    """Return the median step between frames at times [F] in seconds, or None for a single frame.

    Raises InputError if it is implausible.
    """
    if len(time_s) < 2:
        return None
    step_s = float(np.median(np.diff(time_s)))
    if not LEAST_STEP_S <= step_s <= LONGEST_STEP_S:
        problem = f"the median step between frames is {step_s:g}"
        expected = f"expected {LEAST_STEP_S:g} to {LONGEST_STEP_S:g} s"
        fix = "Give seconds: divide milliseconds by 1000, nanoseconds by 1e9"
        raise InputError(f"{problem}, {expected}", fix=fix)
    return step_s


def note_gaps(number: np.ndarray, time_s: np.ndarray) -> list[str]:
    """Return notes about gaps between the numbers [F] and the times [F] of frames."""
    notes = list[str]()
    if len(number) < 2:
        return notes
    is_next = np.diff(number) == 1
    steps_s = np.diff(time_s)
    if not is_next.all():
        notes.append(f"gaps in the numbers of frames: {(~is_next).sum()}")

    # A recorder that drops an image, and numbers the others without a gap, leaves a long step.
    next_s = np.where(is_next, steps_s, 0)
    is_long = next_s > LONG_STEP * np.median(steps_s)
    if is_long.any():
        row = int(np.argmax(next_s))
        notes.append(
            f"gaps in time between neighbouring numbers: {is_long.sum()}, the longest of "
            f"{steps_s[row]:.2f} s after frame {number[row]}"
        )
    return notes


def doubt_gaps(number: np.ndarray, time_s: np.ndarray) -> list[str]:
    """Return a doubt if frames with neighbouring numbers [F] have a gap between their times [F].

    All later stages take such frames for consecutive ones.
    """
    if len(number) < 2:
        return []
    steps_s = np.diff(time_s)
    rows = np.flatnonzero((np.diff(number) == 1) & is_gap(steps_s, float(np.median(steps_s))))
    if not len(rows):
        return []
    row = rows[np.argmax(steps_s[rows])]
    more = f" (and {len(rows) - 1} more)" if len(rows) > 1 else ""
    return [
        f"{DOUBT}frames {number[row]} and {number[row + 1]} are {steps_s[row]:.1f} s apart{more}, "
        "but count as consecutive, so windows, targets and paths cross the gap. Leave out the "
        "numbers of the missing frames"
    ]


def note_unmatched(
    values: Mapping[str, Mapping[int, Any]], names: Iterable[str], frames: Sequence[int]
) -> list[str]:
    """Return notes with counts of values without a frame, and of frames without a value.

    `values` with these `names` are compared with the numbers of all frames. Raises InputError if no
    value belongs to a frame.
    """
    # Text of a note → the names to which it applies.
    notes = dict[str, list[str]]()
    for name in names:
        known = {number for number, value in values[name].items() if np.isfinite(value).any()}
        if known and known.isdisjoint(frames):
            problem = f"{name} has values of frames {min(known)} to {max(known)}"
            expected = f"expected {frames[0]} to {frames[-1]}"
            raise InputError(f"{problem}, {expected}", fix="Number values as the frames")
        extra = len(known.difference(frames))
        missing = len(frames) - len(known.intersection(frames))
        if extra or missing:
            text = f"values without a frame: {extra}, frames without a value: {missing}"
            notes.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in notes.items()]


def rate_doubt(steps_s: Mapping[str, float | None], train: Sequence[str]) -> str | None:
    """Return a doubt if drives have another frame rate than is usual in training, or None.

    `steps_s` maps each drive to its median step in seconds. Without drives in `train`, the rate is
    that of all.
    """
    hz = {name: 1 / step_s for name, step_s in steps_s.items() if step_s}
    usual = [hz[name] for name in train if name in hz] or [*hz.values()]
    if not usual:
        return None
    usual_hz = median_low(usual)
    unusual = [name for name in hz if abs(hz[name] / usual_hz - 1) > RATE_TOLERANCE]
    if not unusual:
        return None
    rates = ", ".join(f"{name} {hz[name]:.1f}" for name in unusual)
    return f"{DOUBT}the usual rate is {usual_hz:.1f} frames/s, but {rates}"


def _check_type(field: object, kind: Any, title: str) -> None:
    """Raise InputError unless a field, which `title` names, is of a kind."""
    if not isinstance(field, kind):
        raise InputError(f"{title} is {_describe(field)}, expected a {kind.__name__}")


def _check_matrix(matrix: Any, shape: tuple[int, int], title: str) -> None:
    """Raise InputError unless a matrix is a finite array of this shape."""
    is_matrix = isinstance(matrix, np.ndarray) and matrix.shape == shape
    if not is_matrix or matrix.dtype.kind not in "iuf" or not np.isfinite(matrix).all():
        raise InputError(f"{title} is {_describe(matrix)}, expected {list(shape)} finite numbers")


def _describe(content: object) -> str:
    """Return the type of something for a message, of an array with its shape."""
    if isinstance(content, np.ndarray):
        return f"{content.dtype} {list(content.shape)}"
    return f"a {type(content).__name__}"


def _is_int(value: object) -> bool:
    return isinstance(value, Integral) and _is_real(value)


def _is_real(value: object) -> bool:
    """Return whether a value is a number of Python or NumPy, and no truth value or duration."""
    return isinstance(value, Real) and not isinstance(value, (bool, np.timedelta64))


def _is_finite(value: Any) -> bool:
    return _is_real(value) and math.isfinite(value)
