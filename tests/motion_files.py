"""Files of stage motion for tests."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.store import DriveWriter
from pipeline.motion.step import PROBLEMS, STANDSTILL


def write_motion(folder: Path, drive: str, rows: dict[int, tuple[float, float]], stands: Sequence[int] = ()) -> None:
    """Write measured motion: frame number → speed and yaw rate; 0, 0 is not measured, in `stands` as nothing moves.

    Frames are 10 s apart, so that means over neighbours are the frames' own values.
    """
    speed, yaw_rate = np.array(list(rows.values()), np.float32).reshape(-1, 2).T
    forth = np.tile(np.eye(4, dtype=np.float32), (len(rows), 1, 1))
    forth[:, 2, 3] = speed / 10
    with DriveWriter(folder / f"{drive}.h5", stage="motion", drive=drive, params={}) as file:
        file.put("frame", np.array(list(rows), np.int32))
        file.put("time_s", np.array(list(rows)) * 10.0)
        for name in ("speed_mps", "filtered_mps"):
            file.put(name, speed)
        file.put("yaw_rate_radps", yaw_rate)
        file.put("valid", (speed != 0).astype(np.uint8))
        problem = PROBLEMS.index("no common motion of the scene") * (speed == 0)
        problem[np.isin(list(rows), stands)] = PROBLEMS.index(STANDSTILL[0])
        file.put("problem", problem.astype(np.uint8))
        file.put("road_height_m", np.ones(len(rows), np.float32))
        file.put("speed_sigma", np.full(len(rows), 0.05, np.float32))
        file.put("scale", np.full(len(rows), 1, np.float32))
        file.put("T_before", forth)
