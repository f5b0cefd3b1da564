"""Small artefacts of earlier stages, made of arithmetic, so that a stage can be tested without running those before."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.base import store
from pipeline.camera.classes import BUILDING, ROAD
from pipeline.graphs import graph, neighbourhoods


def bend(curvature_1pm: float, points: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return xyz [points,3] and cls of a road that bends left with `curvature_1pm`, and walls along it."""
    z = rng.uniform(3, 40, points)
    wall = rng.random(points) < 0.4
    offset = np.where(wall, rng.choice([-8.0, 8.0], points), rng.uniform(-4, 4, points))
    y = np.where(wall, rng.uniform(-3, 1.65, points), 1.65)
    x = offset - curvature_1pm * z**2 / 2  # the camera's x points right
    return np.stack([x, y, z], axis=1).astype(np.float32), np.where(wall, BUILDING, ROAD).astype(np.uint8)


def write_labels(
    path: Path, drive: str, steering_rad: np.ndarray, frame: np.ndarray, valid: np.ndarray | None = None
) -> None:
    """Write a labels file for frames [F] at 10 Hz."""
    valid = np.ones(len(frame), bool) if valid is None else valid
    with store.DriveWriter(path, stage="labels", drive=drive, params={}) as file:
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame * 0.1, unit="s")
        file.put("steering_rad", steering_rad, unit="rad")
        file.put("valid", valid.astype(np.uint8))
        file.put("speed_mps", np.full(len(frame), 8.0), unit="m/s")
        file.put("yaw_rate_radps", 8.0 * np.tan(steering_rad) / 2.7, unit="rad/s")
        file.put("curvature_1pm", np.tan(steering_rad) / 2.7, unit="1/m")


def write_graphs(
    path: Path, drive: str, steering_rad: np.ndarray, frame: np.ndarray, points: int, rng: np.random.Generator
) -> None:
    """Write a graphs file whose frames [F] show roads that bend as `steering_rad` says."""
    columns: dict[str, list[np.ndarray]] = {key: [] for key in ("xyz", "cls", "degree", "indices")}
    made = []
    for steering in steering_rad:
        xyz, cls = bend(float(np.tan(steering)) / 2.7, points, rng)
        made.append(graph.build(xyz, cls, 6, 0.2, rng))
        for key, value in zip(columns, (xyz, cls, made[-1].degree, made[-1].indices), strict=True):
            columns[key].append(value)
    with store.DriveWriter(path, stage="graphs", drive=drive, params={}) as file:
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame * 0.1, unit="s")
        for key, parts in columns.items():
            file.put(key, np.concatenate(parts) if parts else np.empty((0, 3) if key == "xyz" else 0, np.uint8))
        file.put("ptr", store.pointers(len(part) for part in columns["xyz"]))
        file.put("indices_ptr", store.pointers(len(part) for part in columns["indices"]))
        file.put("edges_knn", np.array([one.edges_knn for one in made], np.int32))
        file.put("edges_kept", np.array([one.edges_kept for one in made], np.int32))


def write_sets(
    path: Path, drive: str, steering_rad: np.ndarray, frame: np.ndarray, points: int, rng: np.random.Generator
) -> None:
    """Write a file of variant pointnet2 whose frames [F] show roads that bend as `steering_rad` says.

    The clouds differ in size, and the last one is smaller than the number of centres.
    """
    counts = [points - 2 * (row % 3) for row in range(len(frame) - 1)] + [7]
    clouds = [bend(float(np.tan(steering)) / 2.7, n, rng) for steering, n in zip(steering_rad, counts, strict=True)]
    levels = [neighbourhoods.levels(xyz, [(16, 8.0, 6), (5, 16.0, 4)], rng) for xyz, _ in clouds]
    with store.DriveWriter(path, stage="graphs", drive=drive, params={}) as file:
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame * 0.1, unit="s")
        file.put("xyz", np.concatenate([xyz for xyz, _ in clouds]))
        file.put("cls", np.concatenate([cls for _, cls in clouds]))
        file.put("ptr", store.pointers(counts))
        for number, made in enumerate(zip(*levels, strict=True), start=1):
            file.put(f"centres_{number}", np.concatenate([level.centres for level in made]).astype(np.uint16))
            file.put(f"neighbours_{number}", np.concatenate([level.neighbours for level in made]).astype(np.uint16))
            file.put(f"centres_{number}_ptr", store.pointers(len(level.centres) for level in made))


def write_images(
    path: Path, drive: str, steering_rad: np.ndarray, frame: np.ndarray, points: int, rng: np.random.Generator
) -> None:
    """Write a file of a variant without a cloud: a bright stripe leans as the road bends. `points` says nothing."""
    rows, columns = np.mgrid[:32, :48]
    with store.DriveWriter(path, stage="graphs", drive=drive, params={}) as file:
        file.put("frame", frame.astype(np.int32))
        file.put("time_s", frame * 0.1, unit="s")
        middle = 24 - 100 * steering_rad[:, None, None] * (32 - rows) / 32
        stripe = np.where(np.abs(columns - middle) < 3, 200, 60)[..., None]
        file.put("image", (stripe + rng.integers(0, 30, (*stripe.shape[:3], 3))).astype(np.uint8))


def write_dataset(
    root: Path,
    splits: dict[str, str],
    frames: int = 30,
    points: int = 60,
    seed: int = 0,
    write: Callable[..., None] = write_graphs,
) -> None:
    """Write ``root/graphs/semantic`` (as `write` does) and ``root/labels``: drives of bends both ways."""
    rng = np.random.default_rng(seed)
    for drive in splits:
        phase, rate = rng.uniform(0, 6), rng.uniform(0.1, 0.3)
        steering_rad = 0.12 * np.sin(phase + rate * np.arange(frames))
        write(root / "graphs" / "semantic" / f"{drive}.h5", drive, steering_rad, np.arange(frames), points, rng)
        write_labels(root / "labels" / f"{drive}.h5", drive, steering_rad, np.arange(frames))
    store.write_index(root / "graphs" / "semantic", splits)
    store.write_index(root / "labels", splits)
