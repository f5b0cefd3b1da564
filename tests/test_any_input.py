"""Damaged copies of sound files: readers return sound values or raise one InputError."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera.images import read_image
from pipeline.camera.intrinsics import projection, read_entries
from pipeline.fitting import checkpoint
from pipeline.kitti import oxts
from pipeline.kitti.raw import read_scan

DRIVE = "2026_01_01_drive_0001"
SIZE = (64, 208)
# Seeds are fixed, so that a run tests the code and not luck; files in tmp_path are written anew each time.
anything = settings(
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
Read = Callable[[Path], Any]


def check_names(error: InputError, path: str) -> None:
    assert path in str(error)


def read_times(path: Path) -> np.ndarray:
    return oxts.read_times(path, range(24))


def read_projection(path: Path) -> Any:
    return projection(read_entries(path), 2, path)


def read_pixels(path: Path) -> np.ndarray:
    return read_image(path, SIZE, SIZE)


def read_object(path: Path) -> dict[str, Any]:
    return store.read_json(path, stage="x")


def read_drive(path: Path) -> dict[str, np.ndarray]:
    with store.DriveReader(path, stage=path.parent.name) as file:
        return {name: file[name] for name in file.names} | {"params": np.array(json.dumps(file.params))}


def read_graphs(path: Path) -> dict[str, np.ndarray]:
    from pipeline.graphs import graph_file

    with graph_file.open_graphs(path) as graphs:
        return {name: np.asarray(value) for name, value in graphs.read(0, len(graphs.frame)).items()}


RAW = f"sample/2026_01_01/{DRIVE}_sync"
SOUND: dict[str, Read] = {
    f"{RAW}/oxts/data/0000000003.txt": oxts.read_row,
    f"{RAW}/oxts/timestamps.txt": read_times,
    f"{RAW}/velodyne_points/data/0000000003.bin": read_scan,
    f"{RAW}/image_02/data/0000000003.png": read_pixels,
    "sample/2026_01_01/calib_cam_to_cam.txt": read_projection,
    f"ingest/{DRIVE}.h5": read_drive,
    f"labels/{DRIVE}.h5": read_drive,
    f"graphs/semantic/{DRIVE}.h5": read_graphs,
    "encoder/encoder.pt": checkpoint.load,
    "labels/index.json": read_object,
}
CHECKSUMS = (".h5", ".pt", ".png")


def damage(content: bytes, kind: str, place: float, length: int) -> bytes:
    start = int(place * (len(content) - 1))
    end = min(start + length, len(content))
    match kind:
        case "cut":
            return content[:start]
        case "flip":
            return content[:start] + bytes([content[start] ^ 1 << length % 8]) + content[start + 1 :]
        case "zeros":
            return content[:start] + bytes(end - start) + content[end:]
        case "double":
            return content[:end] + content[start:]
    return content[:start] + content[end:]  # "lose"


def flat(value: Any) -> Any:
    """Return a value that compares by content."""
    import torch

    if isinstance(value, dict):
        return {str(key): flat(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [flat(inner) for inner in value]
    return np.asarray(value).tobytes() if isinstance(value, torch.Tensor | np.ndarray) else value


@pytest.mark.slow
@pytest.mark.parametrize("source", SOUND)
def test_a_damaged_file_is_refused_or_read_as_written(chain: Path, tmp_path: Path, source: str) -> None:
    path = tmp_path / source.split("/")[0] / Path(source).name
    path.parent.mkdir()
    content, read = (chain / "data" / source).read_bytes(), SOUND[source]
    path.write_bytes(content)
    expected = flat(read(path))

    @settings(anything, max_examples=30)
    @given(st.sampled_from(["cut", "flip", "zeros", "double", "lose"]), st.floats(0, 1), st.integers(1, 300))
    def check(kind: str, place: float, length: int) -> None:
        path.write_bytes(damage(content, kind, place, length))
        try:
            value = read(path)
        except InputError as error:
            check_names(error, path.name)
        else:
            assert path.suffix not in CHECKSUMS or flat(value) == expected

    check()
