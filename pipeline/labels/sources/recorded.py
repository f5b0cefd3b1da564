"""The recorded motion of the car: speed and yaw rate of oxts, or of a log."""

from pipeline.base.store import DriveReader
from pipeline.labels.by_row import recorded_motion
from pipeline.labels.label import Car, Labels, steering_labels

MEASURED = False


def read(
    raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool
) -> Labels | None:
    """Return a drive's labels."""
    rates = recorded_motion(raw)
    return None if rates is None else steering_labels(rates[1], rates[0], car)
