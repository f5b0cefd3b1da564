"""Declare section ``ingest``: the drives of each split, their datasets, and how they are read."""

import math
import re
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from pipeline.base.errors import closest
from pipeline.base.params import SPLITS, ImageSize, Name, Section

# Largest magnitude of a steering ratio. Cars have 12 to 20.
LARGEST_RATIO = 50.0
# Name of the dataset of drives that are parts of recordings.
RECORDING = "recording"
# Beginning of the names of a recording's videos in its folder of data/raw.
VIDEO = "video"
# Name of a recording's folder of images in its folder of data/raw.
FRAMES = "frames"
# Names of the datasets: each is a file in pipeline/ingest/datasets.
DATASETS = sorted(path.stem for path in (Path(__file__).parent / "datasets").glob("[!_]*.py"))
# Pattern of the names of KITTI's drives, and of the sample's.
KITTI_NAMES = re.compile(r"\d{4}_\d\d_\d\d_drive_\d{4}")


class Drives(Section):
    """Drives of each split.

    2026_01_01_drive_0001..0009 stands for the nine drives 1 to 9 of a date.
    """

    train: list[Name] = []
    val: list[Name] = []
    test: list[Name] = Field(min_length=1)

    @field_validator(*SPLITS, mode="before")
    @classmethod
    def _expand(cls, names: object) -> object:
        if not isinstance(names, list):
            return names
        return [drive for name in names for drive in _expand_range(name)]

    @model_validator(mode="after")
    def _disjoint(self) -> Self:
        names = self.train + self.val + self.test
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(
                f"{', '.join(twice)} is listed more than once (expected one split per drive)"
            )
        return self

    def splits(self) -> dict[str, str]:
        """Return drive → split, in the order train, val, test."""
        return {drive: split for split in SPLITS for drive in getattr(self, split)}


def _expand_range(name: object) -> list[object]:
    """Return the drives of a range. Any other name stays, and so does an empty range."""
    match = re.fullmatch(r"(.*?)([0-9]+)\.\.([0-9]+)", str(name))
    if not match or len(match[2]) != len(match[3]):
        return [name]
    beginning, first, last = match.groups()
    numbers = range(int(first), int(last) + 1)
    return [f"{beginning}{number:0{len(first)}d}" for number in numbers] or [name]


def _joined(numbers: object) -> object:
    """Return several numbers as text, as on the command line."""
    if isinstance(numbers, str) or not isinstance(numbers, Iterable):
        return numbers
    return ",".join(map(str, numbers))


# Numbers as a text with commas. YAML and Python may pass a list instead.
Numbers = Annotated[str | None, BeforeValidator(_joined)]
# A path. It is not strict, so that a text is taken, too.
File = Annotated[Path | None, Field(strict=False)]


class RecordingOptions(Section):
    """Options of a recording: the lens, the images' times, the camera's height, logs of the car.

    The command line and ingest.recordings use the aliases, Python the names with units.
    """

    fov_deg: float | None = Field(
        default=None,
        alias="fov",
        ge=5,
        le=170,
        description="intrinsics: horizontal field of view, degrees",
    )
    K: Numbers = Field(default=None, description="intrinsics: in pixels", examples=["FX,FY,CX,CY"])
    distortion: Numbers = Field(
        default=None,
        description="lens distortion by OpenCV's model; default: none",
        examples=["K1,K2,P1,P2[,K3]"],
    )
    fisheye: Numbers = Field(
        default=None,
        description="of a fisheye lens, by OpenCV's model; 0,0,0,0: equidistant",
        examples=["K1,K2,K3,K4"],
    )
    fps: float | None = Field(
        default=None,
        ge=0.01,
        le=1000,
        description="times: images per second; default: a video's own times",
    )
    times: File = Field(
        default=None, description="times: a file with the seconds of each image, one per line"
    )
    hz: float | None = Field(
        default=None,
        ge=0.1,
        le=1000,
        description="frames per second that are used; default: about 10 if there are 15 or more",
    )
    camera_height_m: float | None = Field(
        default=None,
        alias="camera_height",
        ge=0.3,
        le=5,
        description="height of the camera over the road, metres",
    )
    motion: File = Field(
        default=None, description="CSV with time_s, speed_mps, yaw_rate_radps (left +)"
    )
    wheel: File = Field(default=None, description="CSV with time_s and wheel_rad (left +)")
    steering_ratio: float | None = Field(
        default=None,
        description=("steering wheel's angle / front wheels'; negative: turns the sign"),
        examples=["NUMBER"],
    )
    offset_s: float = Field(
        default=0.0,
        alias="offset",
        ge=-1e10,
        le=1e10,
        description="seconds to add to the times of --motion and --wheel",
    )

    @field_validator("steering_ratio", mode="plain")
    @classmethod
    def _read_ratio(cls, ratio: Any) -> float:
        """Return a number, which is text on the command line."""
        try:
            number = float(ratio)
        except (TypeError, ValueError):
            raise ValueError("expected a number") from None
        if not 1 <= abs(number) <= LARGEST_RATIO:
            limits = f"expected a magnitude of 1 to {LARGEST_RATIO:g}"
            raise ValueError(f"{limits}; 1 for angles of the front wheels")
        return number


class Part(RecordingOptions):
    """A part of a recording in data/raw. `steer import` writes these settings.

    Logs and times are listed in `files`, not in the options for them.
    """

    folder: Name  # name of the recording's folder in data/raw
    files: dict[str, str]  # name of a file in this folder → SHA-256
    horizon: float | None = Field(
        default=None, ge=-1e4, le=1e4, description="row of the road's horizon; default: estimated"
    )
    start: float = Field(
        default=0.0, ge=0, le=1e10, description="leave out earlier images, seconds since the first"
    )
    end: float | None = Field(
        default=None, ge=0, le=1e10, description="leave out this and later images"
    )

    def shares_images(self, other: Self) -> bool:
        """Return whether another part has images of this part, whatever its folder's name is."""
        if self.folder != other.folder and not self.image_hashes() & other.image_hashes():
            return False
        ends = [part.end for part in (self, other) if part.end is not None]
        return max(self.start, other.start) < min(ends, default=math.inf)

    def image_hashes(self) -> set[str]:
        """Return the hashes of the videos, or the hash of the folder of images."""
        return {hashed for name, hashed in self.files.items() if name.startswith((VIDEO, FRAMES))}

    def span(self) -> str:
        """Return the start and the end as text."""
        end = "the end" if self.end is None else f"{self.end:g} s"
        return f"{self.start:g} s to {end}"


class Reading(Section):
    """The settings by which each drive is read, whatever its split."""

    image_size: ImageSize
    cameras: list[Annotated[int, Field(ge=0, le=3)]] = Field(min_length=1)
    lidar: bool
    on_damaged: Literal["fail", "skip"]


class Ingest(Reading):
    """Section ``ingest``."""

    source: str  # name of a dataset
    drives: Drives
    recordings: dict[Name, Part] = {}  # drives that are parts of recordings, not of `source`

    @model_validator(mode="after")
    def _check_datasets(self) -> Self:
        for drive, dataset in self.datasets().items():
            if dataset not in DATASETS:
                raise ValueError(
                    f"source: there is no pipeline/ingest/datasets/{dataset}.py "
                    f"({closest(dataset, DATASETS)})"
                )
            if dataset == RECORDING and drive not in self.recordings:
                raise ValueError(f"{drive} has no entry in recordings: steer import writes them")
            if dataset in ("kitti", "sample") and not KITTI_NAMES.fullmatch(drive):
                raise ValueError(
                    "drives: expected a drive's name, such as 2011_09_26_drive_0052 "
                    f"(got {drive!r})"
                )
        return self

    @model_validator(mode="after")
    def _check_recordings(self) -> Self:
        """Raise ValueError for logs that are not in files, and for drives that share images.

        Otherwise, a network would be tested on images that it was trained on.
        """
        for drive, part in self.recordings.items():
            if part.times or part.motion or part.wheel:
                raise ValueError(
                    f"recordings.{drive}: logs and times are listed in files: steer import writes "
                    "them"
                )
        drives = [drive for drive in self.drives.splits() if drive in self.recordings]
        for drive, other in combinations(drives, 2):
            part = self.recordings[drive]
            other_part = self.recordings[other]
            if part.shares_images(other_part):
                raise ValueError(
                    f"recordings overlap: {drive} is {part.span()}, {other} is "
                    f"{other_part.span()} of data/raw/{part.folder}. Change start or end of one, "
                    "or remove it from drives"
                )
        return self

    def datasets(self) -> dict[str, str]:
        """Return drive → name of its dataset."""
        return {
            drive: RECORDING if drive in self.recordings else self.source
            for drive in self.drives.splits()
        }
