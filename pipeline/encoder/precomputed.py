"""Depth and classes that were made elsewhere: PNG files by drive and frame number."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.camera import classes
from pipeline.camera.images import read_classes, read_depth, to_metres

BACKBONE = "precomputed"
LAYOUT = "DRIVE/depth/0000000000.png (16 bit, metres x 256, 0 = none) and DRIVE/cls/0000000000.png (8 bit, trainIds)"


class Config(BaseModel):
    """What config.json of stage encoder says, as far as it is read again."""

    backbone: str
    weights: str | dict[str, str] | None


def named_in(encoder: Path) -> Path | None:
    """Return the folder that stage encoder was told to take depth and classes from, if so; `encoder` is its own."""
    config = encoder / "config.json"
    content = store.read_json(config, stage="encoder", form=Config) if config.is_file() else {}
    return Path(str(content["weights"])) if content.get("backbone") == BACKBONE else None


def find(folder: Path) -> list[Path]:
    """Return the PNG files below a folder, sorted. Raises InputError if there are none."""
    files = sorted(folder.glob("*/*/*.png"))
    if not files:
        raise InputError(f"encoder.weights: {folder} holds no PNG files. backbone {BACKBONE} reads {LAYOUT} below it")
    return files


def fingerprint(folder: Path) -> tuple[int, str]:
    """Return how many PNG files lie below a folder, and a hash of names and contents. Raises InputError if none."""
    files = find(folder)
    listing = "".join(f"{file.relative_to(folder)} {file_hash(file)}\n" for file in files)
    return len(files), hashlib.sha256(listing.encode()).hexdigest()


def read(folder: Path, drive: str, frame: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame's depth float32 [H,W] in metres, 0 where there is none, and trainIds uint8 [H,W], 255 for void.

    The files may have any size, of the whole image; pixels are picked for `size` (H, W).

    Raises InputError if a file is missing, damaged, of other pixels, or has numbers that are not classes.
    """
    paths = [folder / drive / kind / f"{frame:010d}.png" for kind in ("depth", "cls")]
    for path in paths:
        if not path.is_file():
            raise InputError(f"{path} is missing: backbone {BACKBONE} needs it for each image, as {LAYOUT}")
    depth = to_metres(read_depth(paths[0], None, size)).astype(np.float32)
    cls = read_classes(paths[1], None, size)
    unknown = np.setdiff1d(cls, [*range(classes.COUNT), classes.VOID])
    if unknown.size:
        raise InputError(f"{paths[1]} has class number {unknown[0]}: trainIds are 0 to {classes.COUNT - 1}, or 255")
    return depth, cls


def read_all(folder: Path, drive: str, frames: Iterable[int], size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return :func:`read` of several frames, [B,H,W] each."""
    depth_m, cls = zip(*(read(folder, drive, frame, size) for frame in frames), strict=True)
    return np.stack(depth_m), np.stack(cls)
