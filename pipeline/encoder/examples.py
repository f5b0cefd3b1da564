"""What a drive can teach the unified encoder: frames, their depth and classes, masks, augmentation. Arrays only."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera import classes
from pipeline.camera.geometry import depth_image, transform

CACHE_BYTES = 1 << 30  # frames up to here stay in memory after the first epoch
OCCLUDER_RAD = 0.004
OCCLUDED_RATIO = 1.25  # of two neighbouring rings on flat ground, one is a quarter nearer only beyond 60 m
DepthSource = Literal["dense", "lidar"]


@dataclass(frozen=True)
class Truth:
    """What is known of a frame: depth [H,W] in metres, 0 where unknown, and trainIds uint8 [H,W], 255 where unknown."""

    depth_m: np.ndarray
    depth_source: DepthSource | None
    cls: np.ndarray
    has_cls: bool


@dataclass(frozen=True)
class Example:
    """A training image uint8 [H,W,3] with its intrinsics [3,3], and a truth as in :class:`Truth`."""

    image: np.ndarray
    K: np.ndarray
    depth_m: np.ndarray
    cls: np.ndarray


def read_truth(drive: DriveReader, row: int) -> Truth:
    """Return what the drive's file of stage ingest knows of the frame in `row`.

    Dense depth goes before projected LiDAR; of the scan's points in a pixel the nearest counts.
    """
    size = image_size(drive)
    depth = np.zeros(size, np.float32)
    source: DepthSource | None = None
    if drive.rows("has_depth", row, row + 1)[0]:
        depth, source = drive.rows("depth", row, row + 1)[0].astype(np.float32) / 256, "dense"
    elif _scanned(drive)[row]:
        start, stop = drive.rows("lidar_ptr", row, row + 2)
        points = drive.rows("lidar", start, stop)[:, :3].astype(np.float64)
        depth = depth_image(transform(drive["T_cam_velo"], points), drive["K"], size).astype(np.float32)
        source = "lidar"
    has_cls = bool(drive.rows("has_cls", row, row + 1)[0])
    cls = drive.rows("cls", row, row + 1)[0] if has_cls else np.full(size, classes.VOID, np.uint8)
    return Truth(depth, source, cls, has_cls)


def visible(depth_m: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Return sparse depth [H,W] without the points that the camera cannot see.

    The scanner looks over things from above the camera; of what it sees behind them, points fall between theirs. A
    point is dropped if another less than 0.23 degrees away (that is about a ring of KITTI's scanner) is a fifth nearer.
    """
    import cv2

    reach = [max(1, round(OCCLUDER_RAD * f)) for f in (K[0, 0], K[1, 1])]
    known = np.where(depth_m > 0, depth_m, np.inf).astype(np.float32)
    nearest = cv2.erode(known, np.ones((2 * reach[1] + 1, 2 * reach[0] + 1), np.uint8))  # erosion is a local minimum
    return np.where(known / OCCLUDED_RATIO <= nearest, depth_m, 0).astype(depth_m.dtype)


def image_size(drive: DriveReader) -> tuple[int, int]:
    """Return (H, W) of the drive's images."""
    _, height, width, _ = drive.shape("image")
    return height, width


def teaching_rows(drive: DriveReader) -> np.ndarray:
    """Return the rows of the frames that have an image and something to learn from it, int64 [n]."""
    known = drive["has_depth"].astype(bool) | drive["has_cls"].astype(bool) | _scanned(drive)
    return np.flatnonzero(drive["has_image"].astype(bool) & known)


def spread(count: int, wanted: int) -> np.ndarray:
    """Return `wanted` of ``range(count)`` in even steps, or all of it if there are no more."""
    if wanted >= count:
        return np.arange(count)
    return (np.arange(wanted) + 0.5) * count // wanted


class Supervision:
    """The training frames of the encoder, read by number; a context manager.

    Frames are read when asked for, so that any number of them can be fitted on; small sets stay in memory.
    """

    def __init__(self, ingest: Path, drives: Sequence[str], frames: int) -> None:
        """Choose `frames` frames, evenly spread over `drives`, from the files of stage ingest.

        Raises InputError if no frame has an image together with depth, classes or a LiDAR scan.
        """
        self._stack = ExitStack()
        self._files = [self._stack.enter_context(DriveReader(ingest / f"{name}.h5", stage="ingest")) for name in drives]
        rows = [(number, int(row)) for number, file in enumerate(self._files) for row in teaching_rows(file)]
        if not rows:
            self._stack.close()
            raise InputError(
                f"no frame of the training drives in {ingest} has an image together with depth, classes or LiDAR: "
                "the encoder has nothing to learn from. Add a drive with LiDAR to ingest.drives.train, or name fitted "
                "weights in encoder.weights and set encoder.epochs: 0"
            )
        self._rows = [rows[int(i)] for i in spread(len(rows), frames)]
        self.frames_per_drive = {
            name: sum(row[0] == number for row in self._rows) for number, name in enumerate(drives)
        }
        self.has_depth = any(bool(file["has_depth"].any() or _scanned(file).any()) for file in self._files)
        self.has_classes = any(bool(file["has_cls"].any()) for file in self._files)
        self.size = image_size(self._files[0])
        self._cache: dict[int, Example] = {}
        self._cached = len(self) * self.size[0] * self.size[1] * (3 + 4 + 1) <= CACHE_BYTES

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, i: int) -> Example:
        if i in self._cache:
            return self._cache[i]
        number, row = self._rows[i]
        file = self._files[number]
        truth = read_truth(file, row)
        depth_m = visible(truth.depth_m, file["K"]) if truth.depth_source == "lidar" else truth.depth_m
        example = Example(file.rows("image", row, row + 1)[0], file["K"], depth_m, truth.cls)
        if self._cached:
            self._cache[i] = example
        return example

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()


def augment(example: Example, rng: np.random.Generator) -> Example:
    """Return the example, mirrored or not, with other brightness, contrast and colour."""
    return relit(mirrored(example) if rng.random() < 0.5 else example, rng)


def mirrored(example: Example) -> Example:
    """Return the view of a camera in a mirrored world: the principal point moves with the pixels."""
    K = example.K.copy()
    K[0, 2] = example.image.shape[1] - 1 - K[0, 2]
    return Example(example.image[:, ::-1], K, example.depth_m[:, ::-1], example.cls[:, ::-1])


def relit(example: Example, rng: np.random.Generator) -> Example:
    """Return the example under another light: a random gain, contrast and gamma, and a gain for each colour."""
    gain = rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 3)
    contrast, gamma = rng.uniform(0.75, 1.3), rng.uniform(0.8, 1.25)
    level = (np.arange(256) / 255) ** gamma
    table = np.clip(255 * (gain[:, None] * (0.45 + contrast * (level - 0.45))), 0, 255).astype(np.uint8)  # [3,256]
    image = np.stack([table[channel][example.image[..., channel]] for channel in range(3)], axis=-1)
    return replace(example, image=image)


def _scanned(drive: DriveReader) -> np.ndarray:
    if "T_cam_velo" not in drive or "lidar" not in drive:
        return np.zeros(len(drive.frame), bool)
    return drive["has_lidar"].astype(bool)
