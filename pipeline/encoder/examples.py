"""Training frames of the unified encoder, and their augmentation."""

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.ingest.truth import read_truth

# Weights by which the colours R, G, B add up to grey, from ITU-R BT.601.
LUMA = np.array([0.299, 0.587, 0.114])
# Share of augmented images that are made grey, since some drives have a grey camera.
GREY = 0.15


class Example(NamedTuple):
    """A training image uint8 [H,W,3], its camera, and its true depth and classes, as in Truth."""

    image: np.ndarray
    camera: Camera
    depth_m: np.ndarray
    cls: np.ndarray


class Examples(ExitStack):
    """Training frames by number, which are read when they are accessed.

    It is a context manager that closes the files of the drives.
    """

    def __init__(self, ingest: Path, drives: Sequence[str], frames: int) -> None:
        """Choose `frames` frames with an image and ground truth, evenly spread over `drives`.

        `ingest` is the folder of stage ingest. Raises InputError if no frame with an image has
        depth, or if none has classes.
        """
        super().__init__()
        any_depth = False
        any_classes = False
        rows: list[tuple[DriveReader, Camera, int]] = []
        for name in drives:
            file = self.enter_context(open_ingest(ingest / f"{name}.h5"))
            camera = read_camera(file)  # the fit does not use its height
            image = file["has_image"].astype(bool)
            depth = image & (file["has_depth"] | file["has_lidar"]).astype(bool)
            cls = image & file["has_cls"].astype(bool)
            any_depth |= depth.any()
            any_classes |= cls.any()
            rows += [(file, camera, row) for row in np.flatnonzero(depth | cls).tolist()]
        for kind, exists in {"depth or LiDAR": any_depth, "classes": any_classes}.items():
            if not exists:
                self.close()
                fix = "Name a fitted encoder.pt, and set encoder.epochs: 0"
                raise InputError(f"no image of the training drives has {kind}", ingest, fix)

        # Divide all frames into `count` equal spans, and take the frame in the middle of each.
        count = min(frames, len(rows))
        self._frames = [rows[int((i + 0.5) * len(rows) // count)] for i in range(count)]
        files = [file for file, _, _ in self._frames]
        self.frames_per_drive = Counter(file.drive for file in files)
        self.datasets = sorted({file.params.get("dataset", "unknown") for file in files})
        _, camera, _ = self._frames[0]
        self.size = camera.size

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int) -> Example:
        file, camera, row = self._frames[i]
        truth = read_truth(file, camera, row)
        return Example(file.row("image", row), camera, truth.depth_m, truth.cls)


def mirror_example(example: Example) -> Example:
    """Return the mirror image of an example. The camera is mirrored, too."""
    return Example(
        example.image[:, ::-1],
        example.camera.mirrored(),
        example.depth_m[:, ::-1],
        example.cls[:, ::-1],
    )


def augment_example(example: Example, rng: np.random.Generator) -> Example:
    """Return the example or its mirror image, with random gain, contrast and gamma.

    The gain differs between colours. A share GREY of the images becomes grey.
    """
    if rng.random() < 0.5:
        example = mirror_example(example)
    gain = rng.uniform(0.75, 1.3) * rng.uniform(0.9, 1.1, 3)
    contrast = rng.uniform(0.75, 1.3)
    gamma = rng.uniform(0.8, 1.25)

    # The new values of the 256 levels of each colour, [3,256]. Contrast is around a level of 0.45.
    level = (np.arange(256) / 255) ** gamma
    level = gain[:, None] * (0.45 + contrast * (level - 0.45))
    table = np.clip(255 * level, 0, 255).astype(np.uint8)
    channels = [table[channel][example.image[..., channel]] for channel in range(3)]
    image = np.stack(channels, axis=-1)
    if rng.random() < GREY:
        image = np.repeat((image @ LUMA).astype(np.uint8)[..., None], 3, axis=-1)
    return example._replace(image=image)
