"""Files of stage motion for tests."""

from pathlib import Path

import numpy as np

from pipeline.base.store import DriveWriter


def write_motion(folder: Path, kind: str, drive: str, rows: dict[int, tuple[float, float]]) -> None:
    """Write measured motion: frame number → speed and yaw rate; 0, 0 is not measured."""
    speed, yaw_rate = np.array(list(rows.values())).T
    with DriveWriter(folder / kind / f"{drive}.h5", stage="motion", drive=drive, params={}) as file:
        file.put("frame", np.array(list(rows), np.int32))
        file.put("speed_mps", speed.astype(np.float32))
        file.put("yaw_rate_radps", yaw_rate.astype(np.float32))
        file.put("valid", (speed != 0).astype(np.uint8))
