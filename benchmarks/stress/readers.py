"""What is tried: readers of files, each with what it takes to call an accepted file right."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stress import originals
from benchmarks.stress.mutations import BINARY, TEXT, Mutation
from pipeline.base import store, yaml_file
from pipeline.base.errors import InputError
from pipeline.base.params import parse
from pipeline.camera import footage
from pipeline.camera.images import read_classes, read_depth, read_image
from pipeline.camera.png import read_png
from pipeline.encoder import perceive
from pipeline.kitti import oxts
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.raw import read_scan
from pipeline.sections import preset
from pipeline.sections.models import resolve
from pipeline.train import frames, predict, runs

Read = Callable[[Path], Any]
Check = Callable[[Path, Any], None]


@dataclass(frozen=True)
class Reader:
    """A reader of the file `name`; `check` raises AssertionError if what it took of another file cannot be right.

    Without `check`, the file has checksums: nothing but what was written may be read.
    """

    name: str
    read: Read
    mutations: tuple[Mutation, ...] = BINARY
    check: Check | None = None
    called: str | None = None
    """The name that it is read by, where it matters."""


def everything(stage: str) -> Read:
    """Return a reader of all datasets and attributes of a drive's file."""

    def read(path: Path) -> Any:
        with store.DriveReader(path, stage=stage) as file:
            datasets = {name: file[name] for name in ("frame", "time_s")} | {name: file[name] for name in file.names}
            return datasets, file.params, file.drive

    return read


def graphs(path: Path) -> Any:
    """Read all frames of a graph file as training does."""
    with frames.open_graphs(path) as file:
        return file.contents, file.frame, file.time_s, file.read(0, len(file.frame))


def check_graphs(path: Path, content: Any) -> None:
    """Check that every number of a graph names a row that there is."""
    _, frame, time_s, arrays = content
    assert (np.diff(frame) > 0).all()
    assert (np.diff(time_s) > 0).all()
    if "indices" in arrays:
        assert arrays["degree"].sum(dtype=int) == len(arrays["indices"])
        assert arrays["indices"].max(initial=0) < len(arrays["xyz"])
    for level in (1, 2):
        if f"centres_{level}" in arrays:
            before = len(arrays["xyz"] if level == 1 else arrays[f"centres_{level - 1}"])
            assert max(arrays[f"{kind}_{level}"].max(initial=0) for kind in ("centres", "neighbours")) < before


def check_frames(path: Path, content: Any) -> None:
    """Check what every stage relies on."""
    datasets = content[0]
    assert (np.diff(datasets["frame"]) > 0).all()
    assert (np.diff(datasets["time_s"]) > 0).all()
    for name, values in datasets.items():
        assert values.dtype.kind != "f" or np.isfinite(values).all()
        if name.endswith("ptr"):
            assert values[0] == 0
            assert (np.diff(values) >= 0).all()


def _packet(path: Path, row: np.ndarray) -> None:
    assert row.tolist() == [float(word) for word in path.read_text(encoding="ascii").split()]
    assert abs(row[oxts.WU]) <= 3
    assert abs(row[oxts.VF]) <= 100


def _times(path: Path, time_s: np.ndarray) -> None:
    assert time_s[0] == 0
    assert (np.diff(time_s) > 0).all()
    assert np.diff(time_s).max() <= 3600


def _camera(path: Path, camera: Any) -> None:
    assert np.isfinite(camera.K).all()
    assert np.linalg.det(camera.K) > 0
    assert min(camera.size) > 0
    R = camera.T_cam_velo[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-2)


def _scan(path: Path, scan: np.ndarray) -> None:
    assert scan.tobytes() == path.read_bytes()
    assert np.isfinite(scan).all()
    assert scan[:, :3].any(axis=1).all()


def _video(path: Path, images: list[footage.Image]) -> None:
    assert all(image.image.dtype == np.uint8 and image.image.ndim == 3 for image in images)
    times = [image.time_s for image in images if image.time_s is not None]
    assert (np.diff(times) > 0).all()


def _valid(path: Path, content: Any) -> None:
    """What the sections let pass is right by their types; here, that it can be written and read again."""
    json.dumps(content, allow_nan=False, default=str)


def _params(path: Path) -> Any:
    whole = parse(preset.Params, yaml_file.read(path), str(path))
    for name, model in whole.models.items():
        try:
            resolve(model)
        except InputError as error:
            raise InputError(f"{path}: models.{name}.{error}") from error
    return whole.model_dump()


def _preset(path: Path) -> Any:
    return preset.merged(str(path))


def _network(path: Path) -> Any:
    model = predict.load(path.parent, "cpu")
    return model.line, model.target, model.contents, model.net.state_dict()


def _encoder(path: Path) -> Any:
    return perceive.load(path.parent).state_dict()


def _read_video(path: Path) -> list[footage.Image]:
    return list(footage.open_footage(path).frames())


SIZE = originals.SIZE
NAMED = f"{originals.DRIVE}.h5"
READERS = (
    Reader("oxts.txt", oxts.read_row, TEXT, _packet),
    Reader("timestamps.txt", lambda path: oxts.read_times(path, range(20)), TEXT, _times),
    Reader("calib_cam_to_cam.txt", lambda path: read_camera(path.parent, 2), TEXT, _camera),
    Reader("calib_velo_to_cam.txt", lambda path: read_camera(path.parent, 2), TEXT, _camera),
    Reader("scan.bin", read_scan, BINARY, _scan),
    Reader("image.png", lambda path: read_image(path, SIZE, SIZE)),
    Reader("depth.png", lambda path: read_depth(path, SIZE, SIZE)),
    Reader("cls.png", lambda path: read_classes(path, SIZE, SIZE)),
    Reader("recorded.png", read_png),
    *(
        Reader(f"{stage}.h5", everything(stage), called=NAMED)
        for stage in ("ingest", "labels", "perception", "motion", "clouds")
    ),
    *(Reader(f"{kind}.h5", graphs, called=NAMED) for kind in ("knn", "sets", "pictures")),
    Reader("index.json", lambda path: store.read_index(path.parent, stage="labels"), TEXT, _valid),
    Reader("config.json", lambda path: store.read_json(path, stage="train@net", form=runs.Config), TEXT, _valid),
    Reader("params.yaml", _params, TEXT, _valid),
    Reader("preset.yaml", _preset, TEXT, _valid),
    Reader("best.pt", _network),
    Reader("encoder.pt", _encoder),
    Reader("video.mp4", _read_video, BINARY, _video),
)


def fingerprint(value: Any) -> str:
    """Return a hash of arrays, tensors and plain values, nested as they are."""
    digest = hashlib.sha256()

    def add(value: Any) -> None:
        if isinstance(value, dict):
            for key in sorted(value, key=str):
                add(str(key))
                add(value[key])
        elif isinstance(value, list | tuple):
            digest.update(b"[")
            for item in value:
                add(item)
        elif hasattr(value, "numpy"):
            add(value.detach().cpu().numpy())
        elif isinstance(value, np.ndarray):
            digest.update(f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
        else:
            digest.update(repr(value).encode())

    add(value)
    return digest.hexdigest()
