"""The files of stage motion: data/motion/<kind>/<drive>.h5, and the index of kinds."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.params import MotionKind
from pipeline.base.store import DriveReader, DriveWriter

if TYPE_CHECKING:
    from pipeline.motion.estimator import Estimate

RESIDUAL_UNITS = {"visual": "px", "lidar": "m"}
MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain
MAX_RATE = 1000.0  # m/s and rad/s: no car, not even at 100 frames per second


class Index(BaseModel):
    """Content of index.json."""

    kinds: list[MotionKind]
    road_frames: float | None = None


def write_index(folder: Path, kinds: Iterable[str], road_frames: float | None = None) -> None:
    """Write ``index.json``; call it when the folder of each kind is complete.

    `road_frames`: share of the frames in which visual odometry found the road.
    """
    store.write_json(
        folder / "index.json", {"schema": store.SCHEMA, "kinds": sorted(kinds), "road_frames": road_frames}
    )


def uncertain_scale(folder: Path) -> str:
    """Return why the scale of visual motion in `folder` is uncertain; empty if it is not, or nothing is measured."""
    if not (folder / "index.json").is_file():
        return ""
    share = store.read_json(folder / "index.json", stage="motion", form=Index).get("road_frames")
    return "" if share is None or share >= MIN_ROAD else f"the road was found in only {share:.0%} of the frames"


def read_index(folder: Path) -> dict[str, Path]:
    """Return kind → its folder. Raises InputError if the index or a drive's file is missing."""
    kinds = store.read_json(folder / "index.json", stage="motion", form=Index)["kinds"]
    for kind in kinds:
        store.read_index(folder / kind, stage="motion")
    return {kind: folder / kind for kind in kinds}


def write(
    file: DriveWriter, kind: str, frame: np.ndarray, time_s: np.ndarray, estimates: Iterable["Estimate | None"]
) -> int:
    """Write data/motion/<kind>/<drive>.h5: each frame's motion since the previous frame, 0 and not valid for None.

    Return the number of valid frames.

    Args:
        frame: KITTI frame numbers [F].
        time_s: their times [F].
        estimates: one for each frame.
    """
    frame = np.asarray(frame, np.int32)
    count = len(frame)
    yaw_rate_radps, speed_mps, residual = np.zeros((3, count), np.float32)
    inliers, valid = np.zeros(count, np.int32), np.zeros(count, np.uint8)
    T_before, scale = np.tile(np.eye(4, dtype=np.float32), (count, 1, 1)), np.ones(count, np.float32)
    for row, estimate in enumerate(estimates):
        if estimate is not None:
            valid[row] = 1
            step, yaw_rate_radps[row], speed_mps[row] = estimate
            T_before[row], inliers[row], residual[row], scale[row] = step
    file.put("frame", frame)
    file.put("time_s", time_s, "s")
    file.put("yaw_rate_radps", yaw_rate_radps, "rad/s, left positive")
    file.put("speed_mps", speed_mps, "m/s, forward positive")
    file.put("inliers", inliers)
    file.put("residual", residual, RESIDUAL_UNITS[kind])
    file.put("valid", valid)
    file.put("T_before", T_before, "m")
    if kind == "visual":
        file.put("scale", scale, "depth was multiplied by it")
    return int(valid.sum())


@contextmanager
def open_motion(folder: Path, drive: str, among: np.ndarray | None = None) -> Iterator[DriveReader]:
    """Open a drive's file in the folder of a kind.

    Raises InputError if a value is impossible, or a frame is not one of the frame numbers `among`, if given.
    """
    with DriveReader(folder / f"{drive}.h5", stage="motion") as file:
        if problem := _fault(file, among):
            raise InputError(problem, file.path, store.fix_hint(file.path, "motion"))
        yield file


def _fault(file: DriveReader, among: np.ndarray | None) -> str:
    """Return what is impossible in a file; empty if nothing is."""
    for name in ("speed_mps", "yaw_rate_radps", "valid"):
        if len(file.shape(name)) != 1:
            return f"{name} has shape {file.shape(name)} (expected one value for each frame)"
        if (largest := float(np.abs(file[name]).max(initial=0))) > MAX_RATE:
            return f"{name} reaches {largest:g} (expected at most {MAX_RATE:g})"
    if "T_before" in file:
        T, rigid = file["T_before"], False
        if T.shape[1:] == (4, 4):
            rigid = np.allclose(np.einsum("fij,fkj->fik", T[:, :3, :3], T[:, :3, :3]), np.eye(3), atol=1e-3)
        if not rigid:
            return "T_before is not a rigid transform [4,4] for each frame"
    if "scale" in file and (file["scale"] <= 0).any():
        return "scale is not positive"
    unknown = np.setdiff1d(file.frame, file.frame if among is None else among)
    return f"has frame {unknown[0]}, which the drive lacks" if len(unknown) else ""
