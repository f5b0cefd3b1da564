"""Labels from the recorded motion of the car: speed and yaw rate of oxts, or of a log."""

from pipeline.base.store import DriveReader
from pipeline.labels.by_row import recorded_motion
from pipeline.labels.label import Car, Labels, steering_labels

MEASURED = False
# Text of the message about a drive that lacks this source.
NEEDS = "The recorded motion of the car: speed and yaw rate of oxts, or of a log"


def read(
    raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool
) -> Labels | None:
    """Return a drive's labels, or None if it has no recorded motion."""
    rates = recorded_motion(raw)
    if rates is None:
        return None
    return steering_labels(rates.yaw_rate_radps, rates.speed_mps, car)
