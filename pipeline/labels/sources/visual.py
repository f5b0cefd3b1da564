"""Labels from the motion that stage motion measures in images, by visual odometry."""

from pipeline.base.store import DriveReader
from pipeline.labels.by_row import measured_motion
from pipeline.labels.label import Car, Labels, steering_labels

MEASURED = True
# Text of the message about a drive that lacks this source.
NEEDS = "The motion that stage motion measures in images, by visual odometry"


def read(
    raw: DriveReader, motion: DriveReader | None, car: Car, *, look_ahead: bool
) -> Labels | None:
    """Return a drive's labels, or None without a file of stage motion.

    Labels are unknown in frames whose motion could not be measured.
    """
    if motion is None:
        return None
    rates = measured_motion(raw, motion, look_ahead=look_ahead)
    return steering_labels(rates.yaw_rate_radps, rates.speed_mps, car)
