"""Files that somebody made to do harm, or by hand: none may be accepted."""

import os
import pickle
import shutil
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stress import originals
from benchmarks.stress.mutated import Tried
from benchmarks.stress.readers import Read
from benchmarks.stress.trial import Outcome, outcomes
from pipeline.camera.images import read_image
from pipeline.encoder import perceive
from pipeline.fitting import checkpoint
from pipeline.kitti import oxts
from pipeline.kitti.calibration import read_camera
from pipeline.kitti.raw import RawDrive, read_scan
from pipeline.train import predict

TENSOR = "temporal.leak"  # of the network of `originals`
Write = Callable[[Path], object]


def tries(sound: Path, scratch: Path) -> Iterator[Tried]:
    """Yield each kind of hostile file, and what does its trials."""
    for name, (read, writes) in FILES.items():
        yield f"{name}, made by hand", partial(_written, sound, scratch, name, read, writes)


def _written(sound: Path, scratch: Path, name: str, read: Read, writes: dict[str, Write]) -> Iterator[Outcome]:
    """Each hostile file of another kind: none may be accepted."""
    folder = Path(shutil.copytree(sound, scratch / "tried", dirs_exist_ok=True))
    path = folder / name
    names = list(writes)

    def work(trial: int) -> bool:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        writes[names[trial]](path)
        read(path)
        raise AssertionError(f"{names[trial]} was not noticed")

    yield from outcomes(work, range(len(names)), path)
    shutil.rmtree(folder)


class _Malicious:
    def __reduce__(self) -> Any:
        return os.system, ("touch ran-code",)


def _pickled(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({"kind": "encoder", "net": _Malicious()}))
        archive.writestr("archive/version", "3\n")


def _bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("archive/data.pkl", "w") as entry:
        for _ in range(256):
            entry.write(bytes(1 << 20))


def _sparse(path: Path) -> None:
    """6 GB that take no room on the disk."""
    with path.open("wb") as file:
        file.truncate(6 << 30)


def _trained(keys: tuple[str, ...], value: Any) -> Write:
    """Return a writer of a checkpoint that holds another value under `keys`."""

    def write(path: Path) -> None:
        originals.write_networks(path.parent)
        content = checkpoint.load(path)
        *outer, last = keys
        inner = content
        for key in outer:
            inner = inner[key]
        inner[last] = value
        checkpoint.write(path, content)

    return write


def _text(text: str) -> Write:
    return lambda path: path.write_text(text, encoding="utf-8")


def _packet(column: str, value: str) -> Write:
    words = ["0.1"] * len(oxts.COLUMNS)
    words[oxts.COLUMNS.index(column)] = value
    return _text(" ".join(words))


def _huge_png(path: Path) -> None:
    import zlib

    header = b"IHDR" + (60000).to_bytes(4, "big") * 2 + bytes([8, 2, 0, 0, 0])
    end = b"\x00\x00\x00\x00IEND\xaeB`\x82"
    crc = zlib.crc32(header).to_bytes(4, "big")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + (13).to_bytes(4, "big") + header + crc + end)


def _scan_of(edit: Callable[[np.ndarray], np.ndarray]) -> Write:
    def write(path: Path) -> None:
        down = np.deg2rad(np.linspace(2, -24.8, 4000))
        points = np.stack([9 * np.cos(down), 0 * down, 9 * np.sin(down), 0 * down + 0.5], 1).astype(np.float32)
        path.write_bytes(edit(points).tobytes())

    return write


def _zeroed(points: np.ndarray) -> np.ndarray:
    points[1500:1600] = 0
    return points


def _folder(*names: str) -> Write:
    def write(path: Path) -> None:
        (path / "oxts/data").mkdir(parents=True)
        for name in names:
            (path / "oxts/data" / name).touch()

    return write


NO_FILE: dict[str, Write] = {
    "a pipe": os.mkfifo,
    "a link to /dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "a folder": lambda path: path.mkdir(),
    "6 GB": _sparse,
    "empty": lambda path: path.write_bytes(b""),
}
ROTATED = "\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
STAMP = "2011-09-26 13:02:25.{:09d}\n"
FILES: dict[str, tuple[Read, dict[str, Write]]] = {
    "oxts.txt": (
        oxts.read_row,
        NO_FILE
        | {
            f"{column} {value}": _packet(column, value)
            for column, value in (
                ("wu", "700"),
                ("wu", "nan"),
                ("vf", "1e300"),
                ("lat", "91"),
                ("lon", "-181"),
                ("yaw", "１"),
            )
        },
    ),
    "timestamps.txt": (
        lambda path: oxts.read_times(path, range(3)),
        NO_FILE
        | {
            "now": _text(STAMP.format(1) + "now\n" + STAMP.format(3)),
            "today": _text("today\n" + STAMP.format(2) + STAMP.format(3)),
            "a year": _text("2011\n2012\n2013\n"),
            "a day later": _text(STAMP.format(1) + STAMP.format(2) + "2011-09-27 13:02:26\n"),
            "February 31st": _text("2011-02-31 13:02:26\n" + STAMP.format(2) + STAMP.format(3)),
        },
    ),
    "calib_cam_to_cam.txt": (
        lambda path: read_camera(path.parent, 2),
        NO_FILE
        | {
            "zeros": _text("S_rect_02: 64 48\nP_rect_02:" + " 0" * 12 + ROTATED),
            "singular": _text("S_rect_02: 64 48\nP_rect_02: 50 0 31 0 50 0 31 0 0 0 1 0" + ROTATED),
            "no size": _text("S_rect_02: 0 0\nP_rect_02: 50 0 31 0 0 50 22 0 0 0 1 0" + ROTATED),
            "a million numbers": _text("P_rect_02:" + " 1" * 1_000_000),
        },
    ),
    "calib_velo_to_cam.txt": (
        lambda path: read_camera(path.parent, 2),
        NO_FILE
        | {
            "zeros": _text("R:" + " 0" * 9 + "\nT: 0 0 0\n"),
            "a mirror": _text("R: -1 0 0 0 1 0 0 0 1\nT: 0 0 0\n"),
            "a kilometre off": _text("R: 1 0 0 0 1 0 0 0 1\nT: 1000 0 0\n"),
        },
    ),
    "scan.bin": (
        read_scan,
        NO_FILE
        | {
            "one point": _scan_of(lambda points: points[-1:]),
            "zeros in the middle": _scan_of(_zeroed),
            "NaN": _scan_of(lambda points: points * np.float32(np.nan)),
        },
    ),
    "image.png": (lambda path: read_image(path, (48, 64), (48, 64)), NO_FILE | {"60,000 x 60,000": _huge_png}),
    "oxts": (
        lambda path: RawDrive(path).oxts,
        {
            "3.txt beside 0000000003.txt": _folder("3.txt", "0000000003.txt"),
            "a number of 20 digits": _folder("00000000000000000003.txt", "9" * 20 + ".txt"),
            "beyond 32 bits": _folder("4294967296.txt"),
        },
    ),
    "best.pt": (
        lambda path: predict.load(path.parent, "cpu"),
        {
            f"{'.'.join(keys)} = {value!r}": _trained(keys, value)
            for keys in (
                ("name",),
                ("seed",),
                ("contents",),
                ("contents", "kind"),
                ("model",),
                ("model", "spatial"),
                ("model", "features"),
                ("model", "layers"),
                ("model", "window"),
                ("target",),
                ("target", "std_rad"),
                ("net",),
                ("net", TENSOR),
            )
            for value in (None, float("nan"), [10**9], -0.5)
        },
    ),
    "encoder.pt": (
        lambda path: perceive.load(path.parent),
        NO_FILE | {"a pickle that runs code": _pickled, "a zip bomb": _bomb},
    ),
}
