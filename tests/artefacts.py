"""Write small artefacts of arithmetic, so that a stage is tested without running those before."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.store import Column
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.classes import BUILDING, ROAD
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.clouds.cloud import Cloud
from pipeline.graphs import frame_graph, graph_file
from pipeline.graphs.settings import Variant
from pipeline.ingest.drive import Drive
from pipeline.ingest.settings import Reading
from pipeline.ingest.write import write_drive
from pipeline.labels import label_file, source
from pipeline.labels.label_file import create_labels
from pipeline.labels.settings import Labels
from pipeline.motion.motion_file import PROBLEMS, STANDSTILL, create_motion
from pipeline.train.frames import join_frames, number_rows

WHEELBASE_M = 2.7
GRAPHS = {"graphs": {"k": 6, "keep_inter_class": 0.2}}
VARIANTS: dict[str, dict[str, Any]] = {
    "graph": {"k": 6, "keep_inter_class": 0.2},
    "points": {},
    "columns": {"k": 4},
}
# Attributes of files of labels.
MEASURED = {"measured": 0}
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
    """Return xyz [points,3] and cls of a road that bends left, and of walls along it."""
    z = rng.uniform(3, 40, points)
    wall = rng.random(points) < 0.4
    offset = np.where(wall, rng.choice([-8.0, 8.0], points), rng.uniform(-4, 4, points))
    y = np.where(wall, rng.uniform(-3, CAMERA_HEIGHT_M, points), CAMERA_HEIGHT_M)
    x = offset - curvature_1pm * z**2 / 2  # the camera's x points right
    xyz = np.stack([x, y, z], axis=1).astype(np.float32)
    cls = np.where(wall, BUILDING, ROAD).astype(np.uint8)
    return xyz, cls


def as_cloud(xyz: np.ndarray, cls: np.ndarray, kind: str) -> Cloud:
    """Return a cloud of points [P,3] and classes [P].

    With kind columns, it has a further column in metres, and one that is not scaled or mirrored.
    """
    if kind != "columns":
        return Cloud.from_arrays(xyz, cls)
    offset_m = np.stack([2 * xyz[:, 0], xyz[:, 1]], axis=1)
    colour = np.stack([np.arange(len(xyz))] * 3, axis=1)
    further = {
        "offset_m": Column(offset_m.astype(np.float32), "m", "ptr", (-1, 1)),
        "colour": Column(colour.astype(np.uint8), "RGB", "ptr", (1, 1, 1)),
    }
    return Cloud.from_arrays(xyz, cls, further)


def write_labels(
    path: Path,
    steering_rad: np.ndarray,
    frame: np.ndarray,
    valid: Any = None,
    ahead_m: Sequence[float] = (),
) -> None:
    """Write a drive's labels file for frames [F] at 10 Hz and 8 m/s.

    It has the path ahead if there are edges `ahead_m`.
    """
    if valid is None:
        valid = np.ones(len(frame), bool)
    speed_mps = np.full(len(frame), 8.0)
    yaw_rate_radps = speed_mps * np.tan(steering_rad) / WHEELBASE_M
    labels = label_file.Labels(steering_rad, valid, speed_mps, yaw_rate_radps)
    settings: dict[str, Any] = dict(LABELS["labels"])
    if ahead_m:
        settings["ahead_m"] = [*ahead_m]
    params = {"labels": settings}
    with create_labels(path, drive=path.stem, params=params) as file:
        file.attrs |= MEASURED
        source.write_labels(file, frame, frame * 0.1, labels, Labels(**settings))


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
) -> dict[str, int | str]:
    """Write a drive's graphs file whose frames [F] show roads that bend as `steering_rad` says.

    `kind`: of VARIANTS, or image, which has no `points`. Clouds of kind points differ in size;
    those of kind columns have further columns. Returns the summary of the drive.
    """
    rng = rng or np.random.default_rng(0)
    frames = []
    if kind == "image":
        empty = {"image": graph_file.Column(np.empty((0, 32, 48, 3), np.uint8), "RGB", "ptr")}
        for image in stripes(steering_rad, rng):
            frames.append({"image": graph_file.Column(image[None], "RGB", "ptr")})
    else:
        # A variant has at least one point, although clouds may be empty.
        variant = Variant(source="clouds/pseudo", points=max(points, 1), **VARIANTS[kind])
        empty = frame_graph.empty_frame(
            as_cloud(np.empty((0, 3), np.float32), np.empty(0, np.uint8), kind), variant
        )
        counts = [points] * len(frame)
        if kind == "points":
            counts = [points - 2 * (row % 3) for row in range(len(frame) - 1)] + [7]
        curvatures_1pm = np.tan(steering_rad) / WHEELBASE_M
        for curvature_1pm, count in zip(curvatures_1pm, counts, strict=True):
            cloud = as_cloud(*bend(curvature_1pm, count, rng), kind)
            frames.append(frame_graph.connect_points(cloud, variant, rng))
    with graph_file.create_graphs(path, drive=path.stem, params=GRAPHS) as file:
        return graph_file.write_frames(file, frame, frame * 0.1, frames, empty)


def write_steered(path: Path, steering_rad: np.ndarray, valid: np.ndarray | None = None) -> None:
    """Write the motion file of a car that steers `steering_rad` [F] at 8 m/s in frames 0 to F - 1.

    It is 0 in frames that are not `valid`.
    """
    if valid is None:
        valid = np.ones(len(steering_rad), bool)
    speed_mps = np.where(valid, 8.0, 0.0)
    yaw_rate_radps = speed_mps * np.tan(steering_rad) / WHEELBASE_M
    rows = enumerate(zip(speed_mps, yaw_rate_radps, strict=True))
    write_motion(path.parent, path.stem, dict(rows))


def collate(*spans: tuple[graph_file.Graphs, int, int]) -> dict[str, np.ndarray]:
    """Return the frames [start, stop) of graph files as one batch."""
    return {name: rows.numpy() for name, rows in number_rows(join_frames(spans)).items()}


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
    """Write graphs/semantic, labels and motion in `root`: drives of bends both ways.

    With `motion`, it is measured from the second frame on, otherwise in no frame.
    """
    rng = np.random.default_rng(0)
    frame = np.arange(frames)
    for drive in splits:
        phase = rng.uniform(0, 6)
        rate = rng.uniform(0.1, 0.3)
        steering_rad = 0.12 * np.sin(phase + rate * frame)
        graphs = root / f"graphs/semantic/{drive}.h5"
        write_graphs(graphs, steering_rad, frame, points, kind, rng)
        write_labels(root / f"labels/{drive}.h5", steering_rad, frame, ahead_m=ahead_m)
        write_steered(root / f"motion/{drive}.h5", steering_rad, motion & (frame > 0))
    write_index(root / "graphs" / "semantic", splits)
    write_index(root / "labels", splits)


def write_recorded(
    path: Path,
    frame: np.ndarray,
    oxts: np.ndarray | None = None,
    steering_rad: dict[int, float] | None = None,
) -> None:
    """Write an ingest file without images, of frames [F] at 10 Hz.

    It may have packets [F,30], and recorded angles: frame number → angle.
    """
    values: dict[str, Any] = {"steering_rad": steering_rad or {}}
    if oxts is not None:
        values["oxts"] = dict(zip(frame.tolist(), oxts, strict=True))
    settings = Reading(image_size=(32, 32), cameras=[2], lidar=True, on_damaged="fail")
    frames = [Frame(number, row / 10) for row, number in enumerate(frame.tolist())]
    camera = Camera(np.array([[32.0, 0, 15.5], [0, 32, 15.5], [0, 0, 1]]), settings.image_size)
    drive = Drive(camera, lambda: iter(frames), values)
    write_drive(path, drive, path.stem, "kitti", settings)


def write_motion(
    folder: Path, drive: str, rows: dict[int, tuple[float, float]], stands: Sequence[int] = ()
) -> None:
    """Write the columns of measured motion that are read: frame number → speed and yaw rate.

    In frames with 0, 0 it is not measured; in frames of `stands`, because nothing moves. Frames are
    10 s apart. Smooth values equal the causal ones.
    """
    frame = np.array(list(rows))
    speed, yaw_rate = np.array(list(rows.values()), np.float32).reshape(-1, 2).T
    problem = np.where(speed == 0, PROBLEMS.index("no common motion of the scene"), 0)
    problem[np.isin(frame, stands)] = PROBLEMS.index(STANDSTILL[0])
    columns = {
        "frame": frame.astype(np.int32),
        "time_s": frame * 10.0,
        "filtered_mps": speed,
        "yaw_rate_radps": yaw_rate,
        "valid": (speed != 0).astype(np.uint8),
        "problem": problem.astype(np.uint8),
        "speed_sigma": np.full(len(rows), 0.05, np.float32),
        "smooth_speed_mps": speed,
        "smooth_yaw_rate_radps": yaw_rate,
        "smooth_speed_sigma": np.full(len(rows), 0.05),
        "smooth_yaw_sigma_radps": np.full(len(rows), 0.003),
    }
    with create_motion(folder / f"{drive}.h5", drive=drive, params={}) as file:
        for name, values in columns.items():
            file.put(name, values)
        file.attrs["scaled"] = 1


def points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return random points [P,3] in metres and classes [P]; most spread is ahead."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(count, 3)) * [10, 2, 30]
    cls = rng.integers(0, 4, count, np.uint8)
    return xyz.astype(np.float32), cls
