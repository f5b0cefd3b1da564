"""Small artefacts of earlier stages, made of arithmetic, so that a stage can be tested without
running those before.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from pipeline.base import store
from pipeline.camera.camera import Frame
from pipeline.camera.classes import BUILDING, ROAD
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.settings import Variant
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.settings import Reading
from pipeline.labels import label, source
from pipeline.labels.settings import Labels
from pipeline.motion.step import PROBLEMS, STANDSTILL
from pipeline.train.frames import join, number_rows

WHEELBASE_M = 2.7
GRAPHS = {"graphs": {"k": 6, "keep_inter_class": 0.2}}
VARIANTS: dict[str, dict[str, Any]] = {
    "graph": {"k": 6, "keep_inter_class": 0.2},
    "points": {"k": 0},
    "pointnet2": {
        "neighbourhood": "pointnet2",
        "centres": [16, 5],
        "radius_m": [8.0, 16.0],
        "neighbours": [6, 4],
    },
}
MEASURED = {"measured": 0}  # attributes of files of labels
LABELS = {"labels": {"wheelbase_m": WHEELBASE_M, "min_speed_mps": 1.0}}


class Trap:
    """What a pickle calls when it is loaded: it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def bend(
    curvature_1pm: float, points: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return xyz [points,3] and cls of a road that bends left with `curvature_1pm`, and walls along
    it.
    """
    z = rng.uniform(3, 40, points)
    wall = rng.random(points) < 0.4
    offset = np.where(wall, rng.choice([-8.0, 8.0], points), rng.uniform(-4, 4, points))
    y = np.where(wall, rng.uniform(-3, CAMERA_HEIGHT_M, points), CAMERA_HEIGHT_M)
    x = offset - curvature_1pm * z**2 / 2  # the camera's x points right
    return np.stack([x, y, z], axis=1).astype(np.float32), np.where(wall, BUILDING, ROAD).astype(
        np.uint8
    )


def write_labels(
    path: Path,
    steering_rad: np.ndarray,
    frame: np.ndarray,
    valid: Any = None,
    ahead_m: Sequence[float] = (),
) -> None:
    """Write a drive's labels file for frames [F] at 10 Hz and 8 m/s, with the path ahead if there
    are edges.
    """
    speed_mps = np.full(len(frame), 8.0)
    params = {"labels": LABELS["labels"] | {"ahead_m": [*ahead_m]}} if ahead_m else LABELS
    with store.DriveWriter(path, stage="labels", drive=path.stem, params=params) as file:
        file.attrs |= MEASURED
        rates = speed_mps, speed_mps * np.tan(steering_rad) / WHEELBASE_M
        labels = label.Labels(
            steering_rad, np.ones(len(frame), bool) if valid is None else valid, *rates
        )
        source.write_labels(file, frame, frame * 0.1, labels, Labels(**params["labels"]))


def stripes(steering_rad: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return images uint8 [F,32,48,3] with a bright stripe that leans as the road bends."""
    rows, columns = np.mgrid[:32, :48]
    middle = 24 - 100 * steering_rad[:, None, None] * (32 - rows) / 32
    stripe = np.where(np.abs(columns - middle) < 3, 200, 60)[..., None]
    return (stripe + rng.integers(0, 30, (*stripe.shape[:3], 3))).astype(np.uint8)


def write_graphs(
    path: Path,
    steering_rad: np.ndarray,
    frame: np.ndarray,
    points: int,
    kind: str = "graph",
    rng: Any = None,
) -> None:
    """Write a drive's graphs file whose frames [F] show roads that bend as `steering_rad` says.

    `kind`: of VARIANTS, or image, which has no `points`. Clouds of kind pointnet2 differ in size,
    and the last is smaller than its centres.
    """
    rng = rng or np.random.default_rng(0)
    if kind == "image":
        frames = (
            {"image": graph_file.Column(image[None], "RGB", "ptr")}
            for image in stripes(steering_rad, rng)
        )
        empty = {"image": graph_file.Column(np.empty((0, 32, 48, 3), np.uint8), "RGB", "ptr")}
    else:
        variant = Variant(source="clouds/pseudo", points=points, **VARIANTS[kind])
        counts = [points] * len(frame)
        if kind == "pointnet2":
            counts = [points - 2 * (row % 3) for row in range(len(frame) - 1)] + [7]
        curvature_1pm = np.tan(steering_rad) / WHEELBASE_M
        clouds = (
            bend(value, count, rng) for value, count in zip(curvature_1pm, counts, strict=True)
        )
        frames, empty = (
            (frame_graph.connect(cloud, variant, rng) for cloud in clouds),
            frame_graph.empty_frame(variant),
        )
    with store.DriveWriter(path, stage="graphs", drive=path.stem, params=GRAPHS) as file:
        graph_file.write(file, frame, frame * 0.1, frames, empty)


def add_motion(path: Path, steering_rad: np.ndarray, valid: np.ndarray | None = None) -> None:
    """Add to a graphs file the motion of a car that steers `steering_rad` [G] at 8 m/s; 0 where it
    is not `valid`.
    """
    valid = np.ones(len(steering_rad), np.uint8) if valid is None else valid.astype(np.uint8)
    speed_mps = np.where(valid, 8.0, 0.0)
    with h5py.File(path, "a") as file:
        file["motion_yaw_rate_radps"] = (speed_mps * np.tan(steering_rad) / WHEELBASE_M).astype(
            np.float32
        )
        file["motion_speed_mps"] = speed_mps.astype(np.float32)
        file["motion_valid"] = valid


def collate(*spans: tuple[graph_file.Graphs, int, int]) -> dict[str, np.ndarray]:
    """Return the frames [start, stop) of graph files as one batch."""
    return {name: rows.numpy() for name, rows in number_rows(join(spans), spans[0][0]).items()}


def write_index(folder: Path, splits: dict[str, str]) -> None:
    """Write the index of a stage's folder."""
    store.write_json(folder / store.INDEX, {"drives": splits}, sort_keys=False)


def write_dataset(
    root: Path,
    splits: dict[str, str],
    frames: int = 30,
    points: int = 60,
    kind: str = "graph",
    ahead_m: Sequence[float] = (),
    motion: bool = False,
) -> None:
    """Write ``root/graphs/semantic`` and ``root/labels``: drives of bends both ways.

    `motion` is measured from the second frame on.
    """
    rng = np.random.default_rng(0)
    for drive in splits:
        phase, rate = rng.uniform(0, 6), rng.uniform(0.1, 0.3)
        steering_rad = 0.12 * np.sin(phase + rate * np.arange(frames))
        graphs, frame = root / f"graphs/semantic/{drive}.h5", np.arange(frames)
        write_graphs(graphs, steering_rad, frame, points, kind, rng)
        write_labels(root / f"labels/{drive}.h5", steering_rad, frame, ahead_m=ahead_m)
        if motion:
            add_motion(graphs, steering_rad, frame > 0)
    write_index(root / "graphs" / "semantic", splits)
    write_index(root / "labels", splits)


def write_recorded(
    path: Path,
    frame: np.ndarray,
    oxts: np.ndarray | None = None,
    steering_rad: dict[int, float] | None = None,
) -> None:
    """Write an ingest file without images: frames [F] at 10 Hz with packets [F,30] or recorded
    angles, or neither.
    """
    settings = Reading(image_size=(32, 32), cameras=[2], lidar=True, on_damaged="fail")
    packets = {} if oxts is None else {"oxts": dict(zip(frame.tolist(), oxts, strict=True))}
    frames = [Frame(number, row / 10) for row, number in enumerate(frame.tolist())]
    drive = Drive(None, lambda: iter(frames), packets | {"steering_rad": steering_rad or {}})
    write_drive(path, drive, path.stem, "recording", settings)


def write_motion(
    folder: Path, drive: str, rows: dict[int, tuple[float, float]], stands: Sequence[int] = ()
) -> None:
    """Write measured motion: frame number → speed and yaw rate; 0, 0 is not measured, in `stands`
    as nothing moves.

    Frames are 10 s apart, so that means over neighbours are the frames' own values.
    """
    speed, yaw_rate = np.array(list(rows.values()), np.float32).reshape(-1, 2).T
    forth = np.tile(np.eye(4, dtype=np.float32), (len(rows), 1, 1))
    forth[:, 2, 3] = speed / 10
    with store.DriveWriter(folder / f"{drive}.h5", stage="motion", drive=drive, params={}) as file:
        file.put("frame", np.array(list(rows), np.int32))
        file.put("time_s", np.array(list(rows)) * 10.0)
        for name in ("speed_mps", "filtered_mps"):
            file.put(name, speed)
        file.put("yaw_rate_radps", yaw_rate)
        file.put("valid", (speed != 0).astype(np.uint8))
        problem = PROBLEMS.index("no common motion of the scene") * (speed == 0)
        problem[np.isin(list(rows), stands)] = PROBLEMS.index(STANDSTILL[0])
        file.put("problem", problem.astype(np.uint8))
        for name, value in {"road_height_m": 1, "speed_sigma": 0.05, "scale": 1}.items():
            file.put(name, np.full(len(rows), value, np.float32))
        file.put("T_before_now", forth)


def points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return random points [P,3] in metres and classes [P], with more spread ahead than to the
    sides.
    """
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, 3)) * [10, 2, 30]).astype(np.float32), rng.integers(
        0, 4, count, np.uint8
    )
