"""The training frames of the unified encoder, kept in memory where they are few, and their augmentation."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.encoder.truth import image_size, no_truth, read_truth, teaching_rows, visible

CACHE_BYTES = 1 << 30  # frames up to here stay in memory after the first epoch
LUMA = np.array([0.299, 0.587, 0.114])  # of ITU-R BT.601
COLOUR_CAMERAS = (2, 3)  # KITTI's
GREY = 0.15  # share of the augmented images that lose their colour: a drive's camera may be grey
Teacher = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""An image uint8 [H,W,3] and its intrinsics [3,3] → trainIds uint8 [H,W] to learn from, 255 where unknown."""


@dataclass(frozen=True)
class Example:
    """A training image uint8 [H,W,3] with its intrinsics [3,3]; depth and classes as in a Truth."""

    image: np.ndarray
    K: np.ndarray
    depth_m: np.ndarray
    cls: np.ndarray


def spread(count: int, wanted: int) -> np.ndarray:
    """Return `wanted` of ``range(count)`` in even steps, or all of it if there are no more."""
    if wanted >= count:
        return np.arange(count)
    return (np.arange(wanted) + 0.5) * count // wanted


class Examples:
    """The training frames of the encoder, read by number; a context manager.

    Frames are read when asked for, so that any number of them can be fitted on; small sets stay in memory.
    """

    def __init__(
        self,
        ingest: Path,
        drives: Sequence[str],
        frames: int,
        teacher: Teacher | None = None,
        untold: Sequence[str] = (),
    ) -> None:
        """Choose `frames` frames, evenly spread over `drives`, from the files of stage ingest.

        A `teacher` names the classes of frames without class truth, of drives with a colour camera: in grey images
        those that learned on colour take trees for people. It sees frames as they are, before any augmentation. Of
        `untold` drives images are read, and nothing else that is known. Raises InputError if no frame has an image
        together with depth, classes, a LiDAR scan or a teacher.
        """
        self._stack = ExitStack()
        self._files = [self._stack.enter_context(DriveReader(ingest / f"{name}.h5", stage="ingest")) for name in drives]
        self._told = [name not in untold for name in drives]
        self._teachers = [teacher if file.attrs.get("camera", 2) in COLOUR_CAMERAS else None for file in self._files]
        self.taught = any(self._teachers)
        rows_of = [
            teaching_rows(file, taught=own is not None, told=told)
            for file, own, told in zip(self._files, self._teachers, self._told, strict=True)
        ]
        rows = [(number, int(row)) for number, own in enumerate(rows_of) for row in own]
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
        told = [(file, own) for file, own, told in zip(self._files, rows_of, self._told, strict=True) if told]
        self.known = {
            what for what in ("depth", "lidar", "cls") if any(file[f"has_{what}"][own].any() for file, own in told)
        }
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
        truth = read_truth(file, row) if self._told[number] else no_truth(file)
        depth_m = visible(truth.depth_m, file["K"]) if truth.depth_source == "lidar" else truth.depth_m
        image, K, cls = file.row("image", row), file["K"], truth.cls
        if (teacher := self._teachers[number]) and not truth.has_cls:
            cls = teacher(image, K)
        example = Example(image, K, depth_m, cls)
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
    """Return the example under another light: a random gain, contrast and gamma, a gain for each colour; some grey."""
    gain = rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 3)
    contrast, gamma = rng.uniform(0.75, 1.3), rng.uniform(0.8, 1.25)
    level = (np.arange(256) / 255) ** gamma
    table = np.clip(255 * (gain[:, None] * (0.45 + contrast * (level - 0.45))), 0, 255).astype(np.uint8)  # [3,256]
    image = np.stack([table[channel][example.image[..., channel]] for channel in range(3)], axis=-1)
    if rng.random() < GREY:
        grey = (image @ LUMA).astype(np.uint8)
        image = np.repeat(grey[..., None], 3, axis=-1)
    return replace(example, image=image)
