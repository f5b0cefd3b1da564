"""Training frames of the unified encoder, and their augmentation."""

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, read_camera
from pipeline.ingest.truth import read_truth

LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
GREY = 0.15  # share of augmented images without colour: some drives have a grey camera


class Example(NamedTuple):
    """A training image uint8 [H,W,3] and its camera; depth and classes as in Truth."""

    image: np.ndarray
    camera: Camera
    depth_m: np.ndarray
    cls: np.ndarray


class Examples(ExitStack):
    """Training frames by number, read on access; a context manager."""

    def __init__(self, ingest: Path, drives: Sequence[str], frames: int) -> None:
        """Choose `frames` frames with an image and ground truth, evenly spread over `drives` of
        stage ingest.

        Raises InputError unless at least one of the drives' frames with an image has depth, and one
        classes.
        """
        super().__init__()
        files = [
            self.enter_context(DriveReader(ingest / f"{name}.h5", stage="ingest"))
            for name in drives
        ]
        # The fit does not use the height.
        drives_with = [(file, read_camera(file), _has_truth(file)) for file in files]
        for column, kind in enumerate(("depth or LiDAR", "classes")):
            if not any(has[:, column].any() for _, _, has in drives_with):
                self.close()
                fix = "Name a fitted encoder.pt, and set encoder.epochs: 0"
                raise InputError(f"no image of the training drives has {kind}", ingest, fix)
        rows = [
            (file, camera, row)
            for file, camera, has in drives_with
            for row in np.flatnonzero(has.any(axis=1)).tolist()
        ]
        count = min(frames, len(rows))
        # middles of equal spans
        self._frames = [rows[int((i + 0.5) * len(rows) // count)] for i in range(count)]
        self.frames_per_drive = Counter(file.drive for file, _, _ in self._frames)
        self.datasets = sorted(
            {file.params.get("dataset", "unknown") for file, _, _ in self._frames}
        )
        self.size = self._frames[0][1].size

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int) -> Example:
        file, camera, row = self._frames[i]
        truth = read_truth(file, camera, row)
        return Example(file.row("image", row), camera, truth.depth_m, truth.cls)


def _has_truth(file: DriveReader) -> np.ndarray:
    """Return whether each frame has an image with depth, and with classes, bool [F,2]."""
    depth, lidar, cls, image = (
        file[f"has_{kind}"].astype(bool) for kind in ("depth", "lidar", "cls", "image")
    )
    return np.stack([depth | lidar, cls], axis=1) & image[:, None]


def mirrored(example: Example) -> Example:
    """Return the mirror image; the principal point moves with the pixels."""
    return Example(
        example.image[:, ::-1],
        example.camera.mirrored(),
        example.depth_m[:, ::-1],
        example.cls[:, ::-1],
    )


def augment(example: Example, rng: np.random.Generator) -> Example:
    """Return the example or its mirror image, with random gain per colour, contrast and gamma; a
    share GREY is grey.
    """
    example = mirrored(example) if rng.random() < 0.5 else example
    gain = rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 3)
    contrast, gamma = rng.uniform(0.75, 1.3), rng.uniform(0.8, 1.25)
    level = (np.arange(256) / 255) ** gamma
    # [3,256]
    table = np.clip(255 * (gain[:, None] * (0.45 + contrast * (level - 0.45))), 0, 255).astype(
        np.uint8
    )
    image = np.stack([table[channel][example.image[..., channel]] for channel in range(3)], axis=-1)
    if rng.random() < GREY:
        image = np.repeat((image @ LUMA).astype(np.uint8)[..., None], 3, axis=-1)
    return example._replace(image=image)
