"""Sound files of every kind that is read, small ones: what mutations begin with."""

import shutil
from pathlib import Path

import numpy as np
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from models.steering.core import steering_net
from pipeline.base import store
from pipeline.base.resume import ROOT, file_hash
from pipeline.camera.calib_file import write_entries
from pipeline.encoder import perceive
from pipeline.fitting import checkpoint
from pipeline.graphs import graph_file
from pipeline.kitti import ingest_file
from pipeline.kitti.oxts import make_rows
from pipeline.sections.models import Model, resolve
from pipeline.train import predict

DRIVE = "2026_01_03_drive_0001"
SIZE = (48, 64)
FRAMES = 8
LINE = {
    "input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 4, "equivariant": False, "learning_rate": None,
    "alpha": 0.0, "features": 8, "horizon": 0, "motion": "none", "fit_to": "train", "roads": None, "layers": [8],
}  # fmt: skip


def write_all(folder: Path, kitti: Path | None) -> None:
    """Write one of each into `folder`; text, scans and images are recorded ones where a KITTI raw folder is at hand."""
    rng = np.random.default_rng(0)
    _write_raw(folder, rng)
    if kitti:
        _copy_raw(folder, kitti)
    _write_hdf5(folder, rng)
    _write_graphs(folder, rng)
    write_networks(folder)
    _write_video(folder / "video.mp4", rng)
    shutil.copy(ROOT / "params.yaml", folder / "params.yaml")
    shutil.copy(ROOT / "presets/kitti.yaml", folder / "preset.yaml")
    store.write_index(folder, {DRIVE: "test"})
    shutil.copy(folder / "labels.h5", folder / f"{DRIVE}.h5")


def _write_raw(folder: Path, rng: np.random.Generator) -> None:
    import cv2

    (packet,) = make_rows(1, lat=49.0, lon=8.4, vf=9.5, wu=0.1, yaw=1.0, numsats=9)
    (folder / "oxts.txt").write_text(" ".join(f"{value:.12f}" for value in packet) + "\n")
    stamps = [f"2011-09-26 13:02:{25 + i / 10:012.9f}\n" for i in range(30)]
    (folder / "timestamps.txt").write_text("".join(stamps))
    P = np.array([[50.0, 0, 31.3, 6.2], [0, 50.0, 22.2, 0.2], [0, 0, 1, 0.003]])
    velo = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    size = np.array([SIZE[1], SIZE[0]], float)
    of_camera: dict[str, str | np.ndarray] = {
        "calib_time": "09-Jan-2012 13:57:47",
        "R_rect_00": np.eye(3),
        "S_rect_02": size,
        "P_rect_02": P,
    }
    write_entries(folder / "calib_cam_to_cam.txt", of_camera)
    write_entries(folder / "calib_velo_to_cam.txt", {"R": velo, "T": np.array([0.0, -0.08, -0.27])})
    down, around = np.deg2rad(np.linspace(2, -24.8, 4000)), rng.uniform(-np.pi, np.pi, 4000)
    ray = np.stack([np.cos(around) * np.cos(down), np.sin(around) * np.cos(down), np.sin(down)], axis=1)
    points = np.hstack([ray * rng.uniform(4, 30, (4000, 1)), rng.uniform(0, 0.99, (4000, 1))])
    (folder / "scan.bin").write_bytes(points.astype(np.float32).tobytes())
    for name, top, dtype, shape in (
        ("image", 256, np.uint8, (*SIZE, 3)),
        ("depth", 20_000, np.uint16, SIZE),
        ("cls", 19, np.uint8, SIZE),
    ):
        cv2.imwrite(str(folder / f"{name}.png"), rng.integers(0, top, shape).astype(dtype))


def _copy_raw(folder: Path, kitti: Path) -> None:
    """Take recorded text, and a scan, in the place of made ones; images keep the trials' size."""
    drive = min(kitti.glob("*/*_sync"))
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        shutil.copyfile(drive.parent / name, folder / name)
    shutil.copyfile(drive / "oxts/timestamps.txt", folder / "timestamps.txt")
    for kind, name in (("oxts", "oxts.txt"), ("velodyne_points", "scan.bin"), ("image_02", "recorded.png")):
        shutil.copyfile(min((drive / kind / "data").iterdir()), folder / name)


def _write_hdf5(folder: Path, rng: np.random.Generator) -> None:
    frame, time_s = np.arange(3, 3 + FRAMES, dtype=np.int32), np.arange(FRAMES) / 10
    image = rng.integers(0, 256, (FRAMES, *SIZE, 3)).astype(np.uint8)
    points = [rng.normal(0, 9, (int(count), 3)).astype(np.float32) for count in rng.integers(40, 90, FRAMES)]

    def made(stage: str) -> store.DriveWriter:
        return store.DriveWriter(folder / f"{stage}.h5", stage=stage, drive=DRIVE, params={stage: {"seed": 0}})

    with made("ingest") as file:
        ingest_file.put_motion(file, frame, time_s, make_rows(FRAMES, vf=9.5, wu=rng.normal(0, 0.1, FRAMES)))
        ingest_file.put_camera(file, np.array([[50.0, 0, 31], [0, 50, 22], [0, 0, 1]]), np.eye(4))
        ingest_file.put_pixels(file, "image", FRAMES, SIZE, list(enumerate(image[:-1])))
        scans = [np.hstack([xyz, np.full((len(xyz), 1), 0.5, np.float32)]) for xyz in points]
        ingest_file.put_scans(file, FRAMES, list(enumerate(scans)))
    with made("labels") as file:
        file.put("frame", frame)
        file.put("time_s", time_s, "s")
        for name in ("steering_rad", "speed_mps", "yaw_rate_radps", "curvature_1pm"):
            file.put(name, rng.normal(0, 0.1, FRAMES))
        file.put("valid", np.ones(FRAMES, np.uint8))
    with made("perception") as file:
        file.put("frame", frame)
        file.put("time_s", time_s, "s")
        file.put("depth_m", rng.integers(0, 20_000, (FRAMES, *SIZE)).astype(np.uint16), "1/256 m")
        file.put("cls", rng.integers(0, 19, (FRAMES, *SIZE)).astype(np.uint8))
    with made("motion") as file:
        file.put("frame", frame)
        file.put("time_s", time_s, "s")
        for name in ("yaw_rate_radps", "speed_mps", "residual"):
            file.put(name, rng.normal(0, 1, FRAMES).astype(np.float32))
        file.put("valid", np.ones(FRAMES, np.uint8))
        file.put("T_before", np.tile(np.eye(4, dtype=np.float32), (FRAMES, 1, 1)))
    with made("clouds") as file:
        file.put("frame", frame)
        file.put("time_s", time_s, "s")
        for xyz in points:
            file.append("xyz", xyz, "m")
            file.append("cls", rng.integers(0, 19, len(xyz)).astype(np.uint8))
        file.put_pointers("ptr", map(len, points))


def _write_graphs(folder: Path, rng: np.random.Generator) -> None:
    frame, time_s = np.arange(3, 3 + FRAMES, dtype=np.int32), np.arange(FRAMES) / 10

    def clouds() -> list[graph_file.Points]:
        return [
            (rng.normal(0, 5, (60, 3)).astype(np.float32), rng.integers(0, 19, 60).astype(np.uint8), rng) for _ in frame
        ]

    sizes = [(20, 5.0, 4), (5, 9.0, 4)]
    for name, kind in (("knn", graph_file.KnnGraph(60, 5, 0.3)), ("sets", graph_file.PointSets(60, sizes))):
        with store.DriveWriter(folder / f"{name}.h5", stage="graphs", drive=DRIVE, params={}) as file:
            graph_file.write_points(file, frame, time_s, clouds(), kind)
    with store.DriveWriter(folder / "pictures.h5", stage="graphs", drive=DRIVE, params={}) as file:
        images = rng.integers(0, 256, (FRAMES, *SIZE, 3)).astype(np.uint8)
        graph_file.write_images(file, frame, time_s, images, SIZE)


def write_networks(folder: Path) -> None:
    """Write a steering network and an encoder with their first weights."""
    torch.manual_seed(0)
    line = resolve(Model.model_validate(LINE))
    target = {"mean_rad": 0.01, "std_rad": 0.05, "wheelbase_m": 2.71, "min_speed_mps": 1.0}
    about = {"name": "net", "seed": 0, "fold": None, "contents": {"kind": "graph"}, "target": target, "model": line}
    net = steering_net.build(line, "graph")
    checkpoint.write(folder / "best.pt", {**about, "kind": predict.KIND, "net": net.state_dict()})
    config = {
        **about,
        "seeds": [0],
        "parameters": 1,
        "best_sha256": file_hash(folder / "best.pt"),
        "best_epoch": 1,
        "epochs": 2,
    }
    store.write_json(folder / "config.json", config)
    perceive.save(folder, "small", UnifiedEncoder("small").state_dict())


def _write_video(path: Path, rng: np.random.Generator) -> None:
    import cv2

    file = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 10.0, SIZE[::-1])
    for level in rng.integers(0, 200, 12):
        file.write(np.full((*SIZE, 3), level, np.uint8))
    file.release()
