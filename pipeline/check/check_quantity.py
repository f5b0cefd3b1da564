"""Run a quantity on the labels of a short drive, and find the rules that it breaks.

A quantity that breaks one stops a training, its evaluation or the report, or its errors look like
results. The rules are those of pipeline/train/quantity.py: results have a row per frame, and
unknown values are NaN.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pipeline.base.errors import InputError
from pipeline.labels.label import Car, steering_labels
from pipeline.labels.label_file import create_labels, open_labels
from pipeline.labels.settings import Labels
from pipeline.labels.source import write_labels
from pipeline.train.quantity import NMSE, Quantity

# Number of frames of the drive.
FRAMES = 600
# Time in seconds between two frames.
STEP_S = 0.1
# Speed in m/s of the car, except in the first frames.
SPEED_MPS = 20.0
# Largest yaw rate in rad/s of the winding road.
YAW_RATE_RADPS = 0.3
# Number of frames for which the car stands, then reverses, then has an unknown motion.
SPECIAL = 10
# Factor by which the world is scaled.
FACTOR = 1.25
# Largest difference between equal values, relative to the largest value. Training has float32.
ROUNDING = 1e-5


def check_quantity(quantity: Quantity, settings: Labels) -> None:
    """Run the methods of a quantity on labels that have these settings.

    Raises InputError for the first rule that it breaks. An exception of the quantity itself is
    raised as it is.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "labels.h5"
        angle_rad = _write_drive(path, settings)
        read = _read_values(quantity, path)

    columns = len(quantity.columns)
    truth = _to_array(read, "read", (FRAMES, columns))
    # The angle is unknown before the first measurement.
    angle_rad[0] = np.nan
    measured = _to_array(quantity.measured(angle_rad), "measured", (FRAMES, columns))
    _check_scaling(quantity, truth.astype(np.float32), measured.astype(np.float32))

    # Errors are those of the values of all seeds together, [S,F,R].
    _to_array(quantity.shown(truth[None]), "shown", (1, FRAMES))
    _check_lead(quantity)
    _to_array(quantity.errors(truth[None], truth), "errors", (1, FRAMES, len(quantity.ends)))
    ranges = len(quantity.edges_m) - 1
    _to_array(quantity.curvature(truth), "curvature", (FRAMES, ranges))


def _write_drive(path: Path, settings: Labels) -> np.ndarray:
    """Write the labels of a drive on a winding road as stage labels does.

    Speed and yaw rate are NaN in the frames of unknown motion. Returns the steering angles [F].
    """
    time_s = np.arange(FRAMES) * STEP_S
    yaw_rate_radps = YAW_RATE_RADPS * np.sin(time_s)
    speed_mps = np.full(FRAMES, SPEED_MPS)
    speed_mps[:SPECIAL] = 0.0
    yaw_rate_radps[:SPECIAL] = 0.0
    speed_mps[SPECIAL : 2 * SPECIAL] = -SPEED_MPS
    speed_mps[2 * SPECIAL : 3 * SPECIAL] = np.nan
    yaw_rate_radps[2 * SPECIAL : 3 * SPECIAL] = np.nan

    car = Car(settings.wheelbase_m, settings.min_speed_mps)
    labels = steering_labels(yaw_rate_radps, speed_mps, car)
    if settings.angle == "recorded":
        # A recorded angle is a valid label also where the speed is unknown.
        labels = labels._replace(valid=labels.valid | np.isnan(speed_mps))
    params = {"labels": settings.model_dump()}
    with create_labels(path, drive=path.stem, params=params) as file:
        file.attrs["measured"] = int(settings.are_measured)
        write_labels(file, np.arange(FRAMES), time_s, labels, settings)
    return labels.steering_rad


def _read_values(quantity: Quantity, path: Path) -> np.ndarray:
    """Return what the quantity reads from a file of labels. Raises InputError if it lacks some."""
    with open_labels(path) as labels:
        try:
            return quantity.read(labels)
        except InputError as error:
            # The file is temporary, so its name would not help.
            fix = "Set what it needs in section labels, or write it in pipeline/labels/source.py"
            raise InputError(f"read: {error.problem}", fix=error.fix or fix) from error


def _check_scaling(quantity: Quantity, truth: np.ndarray, measured: np.ndarray) -> None:
    """Check true and measured values, both float32 [F,R], in a larger world."""
    truth[-1] = np.nan
    base = np.nan_to_num(measured)
    _to_array(quantity.rescale_measured(base, FACTOR), "rescale_measured", base.shape)

    scaled = _to_array(quantity.rescale(truth.copy(), FACTOR), "rescale", truth.shape)
    if np.isfinite(scaled[-1]).any():
        problem = "rescale returns numbers where all values are unknown"
        raise InputError(problem, fix="Return NaN there, or training takes them for true values")

    same = _to_array(quantity.rescale(truth.copy(), 1.0), "rescale", truth.shape)
    limit = ROUNDING * np.nanmax(np.abs(truth), initial=0.0)
    if not np.allclose(same, truth, rtol=0, atol=limit, equal_nan=True):
        raise InputError("rescale by a factor of 1 returns other values")


def _check_lead(quantity: Quantity) -> None:
    """Raise InputError unless the error that leads is one of those that have the measure."""
    has_own_error = quantity.measure is not NMSE
    if has_own_error != bool(quantity.ends) or quantity.lead not in (quantity.ends or [""]):
        problem = f"lead is {quantity.lead!r}, ends are {[*quantity.ends]}"
        fix = "Set measure, ends and lead, which is one of ends, or none of the three"
        raise InputError(problem, fix=fix)


def _to_array(values: np.ndarray, method: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return what a method returned as float64. Raises InputError for another shape or infinity."""
    values = np.asarray(values, np.float64)
    if values.shape != shape:
        problem = f"{method} returns the shape {list(values.shape)}, expected {list(shape)}"
        raise InputError(problem, fix="See docs/models.md, Predict another quantity")
    if np.isinf(values).any():
        raise InputError(f"{method} returns infinity", fix="Return NaN where a value is unknown")
    return values
