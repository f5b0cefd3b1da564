"""Training frames of the unified encoder, in memory if they are few, and their augmentation."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, read_camera
from pipeline.camera.mount import CAMERA_HEIGHT_M
from pipeline.perception.truth import read_truth, training_rows

CACHE_BYTES = 1 << 30  # data sets up to this size stay in memory after the first epoch
LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
# Shares of augmented images without colour: some drives have a grey camera. A teacher is for real streets.
GREY, GREY_OF_TEACHER = 0.15, 0.5
Classify = Callable[[np.ndarray, Camera], np.ndarray]
"""Image uint8 [H,W,3] and its camera → trainIds uint8 [H,W], 255 where unknown."""


@dataclass(frozen=True)
class Example:
    """A training image uint8 [H,W,3] and its camera; depth and classes as in Truth."""

    image: np.ndarray
    camera: Camera
    depth_m: np.ndarray
    cls: np.ndarray


def spread(count: int, wanted: int) -> np.ndarray:
    """Return `wanted` evenly spaced numbers of ``range(count)``, or all of them if there are fewer."""
    if wanted >= count:
        return np.arange(count)
    return (np.arange(wanted) + 0.5) * count // wanted


@dataclass(frozen=True)
class _Drive:
    file: DriveReader
    camera: Camera
    teacher: Classify | None
    labelled: bool
    rows: np.ndarray  # of frames with a training target


class Examples:
    """Training frames by number, read on access; a context manager."""

    def __init__(
        self,
        ingest: Path,
        drives: Sequence[str],
        frames: int,
        teacher: Classify | None = None,
        unlabelled: Sequence[str] = (),
    ) -> None:
        """Choose `frames` frames, evenly spread over `drives`, from the files of stage ingest.

        A `teacher` classifies frames without class labels, before augmentation. It skips drives whose first image is
        grey, where networks trained on colour confuse road and sidewalk. Ground truth of `unlabelled` drives is
        ignored.
        Raises InputError if no frame has an image together with depth, classes, a LiDAR scan or a teacher.
        """
        self._stack = ExitStack()
        self._drives = [self._open(ingest / f"{name}.h5", teacher, name not in unlabelled) for name in drives]
        frame_rows = [(drive, int(row)) for drive in self._drives for row in drive.rows]
        if not frame_rows:
            self._stack.close()
            raise InputError(
                "no frame of the training drives has an image together with depth, classes or LiDAR",
                ingest,
                "Add a drive with LiDAR to ingest.drives.train, or name fitted weights in encoder.weights and set "
                "encoder.epochs: 0",
            )
        self._frames = [frame_rows[int(i)] for i in spread(len(frame_rows), frames)]
        self.has_teacher = any(drive.teacher for drive in self._drives)
        self.grey = GREY_OF_TEACHER if self.has_teacher else GREY
        self.frames_per_drive = {
            name: sum(source is drive for source, _ in self._frames)
            for name, drive in zip(drives, self._drives, strict=True)
        }
        self.ground_truth = {
            kind
            for kind in ("depth", "lidar", "cls")
            if any(drive.labelled and drive.file[f"has_{kind}"][drive.rows].any() for drive in self._drives)
        }
        self.size = self._drives[0].camera.size
        self._cache: dict[int, Example] = {}
        self._cached = len(self) * self.size[0] * self.size[1] * (3 + 4 + 1) <= CACHE_BYTES

    def _open(self, path: Path, teacher: Classify | None, labelled: bool) -> _Drive:
        file = self._stack.enter_context(DriveReader(path, stage="ingest"))
        if teacher and is_grey(file):
            teacher = None
        camera = read_camera(file, CAMERA_HEIGHT_M)  # the fit does not use the height
        return _Drive(file, camera, teacher, labelled, training_rows(file, bool(teacher), labelled))

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int) -> Example:
        if i in self._cache:
            return self._cache[i]
        drive, row = self._frames[i]
        image = drive.file.row("image", row)
        truth = read_truth(drive.file, drive.camera, row, drive.labelled)
        cls = drive.teacher(image, drive.camera) if drive.teacher and not truth.has_cls else truth.cls
        example = Example(image, drive.camera, truth.depth_m, cls)
        if self._cached:
            self._cache[i] = example
        return example

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def is_grey(file: DriveReader) -> bool:
    """Return whether the first image of a file of stage ingest is grey; its camera's number does not show it."""
    rows = np.flatnonzero(file["has_image"])
    return len(rows) > 0 and not np.ptp(file.row("image", rows[0]), axis=-1).any()


def augment(example: Example, rng: np.random.Generator, grey: float) -> Example:
    """Return the example with random mirroring, brightness, contrast and colour; a share `grey` without colour."""
    return relit(mirrored(example) if rng.random() < 0.5 else example, rng, grey)


def mirrored(example: Example) -> Example:
    """Return the mirror image; the principal point moves with the pixels."""
    return Example(example.image[:, ::-1], example.camera.mirrored(), example.depth_m[:, ::-1], example.cls[:, ::-1])


def relit(example: Example, rng: np.random.Generator, grey: float) -> Example:
    """Return the example with random gain, contrast, gamma and gain per colour; a share `grey` without colour."""
    gain = rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 3)
    contrast, gamma = rng.uniform(0.75, 1.3), rng.uniform(0.8, 1.25)
    level = (np.arange(256) / 255) ** gamma
    table = np.clip(255 * (gain[:, None] * (0.45 + contrast * (level - 0.45))), 0, 255).astype(np.uint8)  # [3,256]
    image = np.stack([table[channel][example.image[..., channel]] for channel in range(3)], axis=-1)
    if rng.random() < grey:
        image = np.repeat((image @ LUMA).astype(np.uint8)[..., None], 3, axis=-1)
    return replace(example, image=image)
