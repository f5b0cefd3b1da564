"""Convert recordings, once, to drives in KITTI raw's layout.

A recording is a video, several that follow each other, or a folder of images, with logs of the car.
Its drives are ``NAME/NAME_drive_0001_sync`` and so on, with the files ``image_02/data/%010d.jpg``,
``image_02/timestamps.txt``, ``motion.csv`` and ``steering.csv``. They share the calibration in
``NAME/``.
"""

import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
from tqdm import tqdm

from footage.lens import Rectify, open_lens
from footage.log import Logs, logged_values, range_note, read_logs, read_times
from footage.settings import Options
from footage.video import CONVERT, Images, open_images
from pipeline.base.errors import DamagedFile, InputError, error_context
from pipeline.camera.camera import Camera
from pipeline.camera.images import Size, format_size, resize_image
from pipeline.ingest.calibration import write_calibration
from pipeline.ingest.packets import VALUE_FILES, format_times, write_values
from pipeline.motion.horizon import HorizonFinder, horizon_row

# Largest width of written images in pixels, which is that of KITTI's.
MAX_WIDTH = 1242
# Frames per second that odometry and networks need. With 60 and 120, steps are so short that errors
# of tracking count, and the angle is worse.
USUAL_HZ = 10.0
# Options of JPEG files: quality, and colours at the full resolution. With colours at half of it,
# the error of the pixels is twice as large.
JPEG = (
    *(cv2.IMWRITE_JPEG_QUALITY, 95),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
)
# Day on which all recordings begin, at midnight.
DAY = "2000_01_01"
# Seconds left out between the parts of a recording, as neighbouring images are almost the same.
GAP_S = 2.0
# Largest difference between the horizons of two files, as a share of the image's height. Beyond it,
# the camera was moved.
MOVED = 0.02


@dataclass
class Recording:
    """Files that follow each other, and the logs of the car."""

    files: list[Images]
    # Times of all images by a file, or None.
    times_s: np.ndarray | None
    logs: Logs

    @property
    def step_s(self) -> float:
        """The median time between two images."""
        if self.times_s is not None:
            return float(np.median(np.diff(self.times_s)))
        return self.files[0].step_s

    def every(self, hz: float) -> int:
        """Return n, if every n-th image becomes one of about `hz` frames a second."""
        return max(1, round(1 / (self.step_s * hz)))

    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last image as the files' headers have them."""
        if self.times_s is not None:
            return float(self.times_s[0]), float(self.times_s[-1])
        between_s = sum(file.step_s for file in self.files[:-1])
        return 0.0, between_s + sum(file.length_s for file in self.files)

    def images(self, every: int) -> Iterator[tuple[Path, float, np.ndarray]]:
        """Yield every n-th image with its file and its time in seconds.

        Raises DamagedFile if times do not increase, and InputError if there are more or fewer
        images than times.
        """
        begin_s = 0.0
        count = 0
        time_s = -np.inf
        for file in self.files:
            for stamp_s, image in file.read(every, count):
                before_s = time_s
                time_s = begin_s + stamp_s
                if self.times_s is not None:
                    time_s = self.times_s[min(count, len(self.times_s) - 1)]
                elif not time_s > before_s:
                    fix = "If the file is not damaged there, pass --fps"
                    raise DamagedFile(f"times do not increase at image {count}", file.path, fix)
                if image is not None:
                    yield file.path, time_s, image
                count += 1
            begin_s = time_s + file.step_s
        if self.times_s is not None and count != len(self.times_s):
            problem = f"has {count} images, but {len(self.times_s)} times"
            raise InputError(problem, self.files[0].path)


class Optics(NamedTuple):
    """How images become frames."""

    size: Size  # of the recorded images
    rectify: Rectify
    camera: Camera  # of the frames
    first: np.ndarray  # the first frame

    @classmethod
    def open(cls, options: Options, images: Images) -> "Optics":
        """Return the optics of images by the options of their lens. Raises InputError."""
        _, image = next(images.read(1, 0), (0.0, None))
        if image is None:
            raise DamagedFile("has no images", images.path, CONVERT.format(name=images.path.name))
        height, width = image.shape[:2]
        camera, rectify = open_lens(options, (height, width), images.path)
        if width > MAX_WIDTH:
            camera = camera.scaled((round(height * MAX_WIDTH / width), MAX_WIDTH))
        return cls((height, width), rectify, camera, resize_image(rectify(image), camera.size))

    def to_frame(self, image: np.ndarray, path: Path) -> np.ndarray:
        """Return the rectified image of a file in the size of the camera. Raises InputError."""
        if image.shape[:2] != self.size:
            problem = f"an image has {format_size(image.shape)} pixels"
            expected = f"expected {format_size(self.size)}, as the first one"
            fix = "Import recordings of other sizes separately"
            raise InputError(f"{problem}, {expected}", path, fix)
        return resize_image(self.rectify(image), self.camera.size)


@dataclass
class Drive:
    """A drive that is being written."""

    folder: Path
    # The written images, and their times in the recording.
    images: list[Path] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def write_image(self, image: np.ndarray, time_s: float, *, png: bool) -> None:
        """Write the next image, RGB uint8 [H,W,3]."""
        suffix = ".png" if png else ".jpg"
        path = self.folder / f"image_02/data/{len(self.images):010d}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(_encoded(image, png=png))
        self.images.append(path)
        self.times_s.append(time_s)


class Converted(NamedTuple):
    """What a conversion wrote."""

    drives: list[Drive]
    camera: Camera
    # Frames per second.
    hz: float
    notes: list[str]
    doubts: list[str]
    # Content of import.json.
    record: dict[str, Any]


def open_recording(paths: Sequence[Path], options: Options) -> Recording:
    """Open a video, several that follow each other, or a folder of images, without decoding them.

    Raises InputError if files are missing or have no times, or a log is faulty or of another time.
    """
    if options.fps and options.times:
        problem = "expected one source of the images' times, got two"
        raise InputError(problem, fix="Pass --fps or --times")
    logs = read_logs(options)
    files = [open_images(path) for path in paths]
    times_s = None
    if options.times:
        times_s = read_times(options.times)
        images = sum(len(file.files) for file in files)
        if images and images != len(times_s):
            raise InputError(f"has {images} images, but {len(times_s)} times", paths[0])
    else:
        files = [file.at_rate(options.fps) for file in files]
    recording = Recording(files, times_s, logs)
    for log in logs.values():
        log.check_overlap(*recording.span_s())
    return recording


def convert(
    folder: Path,
    name: str,
    recordings: Sequence[Recording],
    options: Options,
    *,
    shares: Sequence[float] = (100.0,),
    hz: float = USUAL_HZ,
) -> Converted:
    """Write the drives of recordings of one camera, and their calibration, to the new `folder`.

    Each recording is cut into parts with `shares` of its time, in %, and each part is a drive. Of
    the images, every n-th is written, so that about `hz` a second remain.

    Raises InputError if images have several sizes, the lens does not fit, a part is too short, a
    log has no value, images are upside down, or the disk is too small. Raises DamagedFile if an
    image cannot be decoded, images are missing at the end, or times do not increase.
    """
    folder.mkdir(parents=True)
    edges_s = [_edges(recording, shares) for recording in recordings]
    optics = Optics.open(options, recordings[0].files[0])
    files = [file for recording in recordings for file in recording.files]
    frames = 0
    for recording in recordings:
        frames += sum(file.count for file in recording.files) // recording.every(hz)
    _check_disk(folder, optics, frames, options)

    drives = list[Drive]()
    notes = list[str]()
    finders = {file.path: HorizonFinder(optics.camera) for file in files}
    with tqdm(total=frames, desc="convert", unit=" images", disable=None) as bar:
        for recording, edges in zip(recordings, edges_s, strict=True):
            numbers = range(len(drives) + 1, len(drives) + 1 + len(shares))
            parts = [Drive(folder / f"{name}_drive_{number:04d}_sync") for number in numbers]
            for path, time_s, image in recording.images(recording.every(hz)):
                place = int(np.searchsorted(edges, time_s, side="right"))
                in_gap = place < len(edges) and time_s >= edges[place] - GAP_S
                if not in_gap:
                    frame = optics.to_frame(image, path)
                    parts[place].write_image(frame, time_s, png=options.png)
                    finders[path].add(frame)
                bar.update()
            notes += _write_values(recording, parts)
            drives += parts

    horizon, note, doubts = _find_horizon(finders, optics.camera)
    camera = replace(optics.camera, horizon=horizon).at_height(options.camera_height_m)
    write_calibration(folder, camera)
    written = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.*"))
    record = {
        "version": version("semantic-steering"),
        "options": options.model_dump(mode="json", by_alias=True, exclude_defaults=True),
        "recordings": [describe(file.path) for file in files],
        "files": written,
    }
    return Converted(
        drives,
        camera,
        1 / (recordings[0].step_s * recordings[0].every(hz)),
        [*notes, note],
        doubts,
        record,
    )


def _edges(recording: Recording, shares: Sequence[float]) -> np.ndarray:
    """Return the times at which all parts but the first begin.

    Raises InputError if a part would have fewer than two frames.
    """
    first_s, last_s = recording.span_s()
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), edges_s[-1]]
    for share, begin_s, end_s in zip(shares, edges_s[:-1], ends_s, strict=True):
        if len(shares) > 1 and end_s - begin_s < 2 / USUAL_HZ:
            length = f"{last_s - first_s:.1f} s in all"
            problem = f"the part of {share:g} % has fewer than 2 images ({length})"
            gap = f"{GAP_S:g} s are left out between parts"
            raise InputError(problem, "--split", f"Pass a longer recording, or other shares: {gap}")
    return edges_s[1:-1]


def _write_values(recording: Recording, parts: Sequence[Drive]) -> list[str]:
    """Write the times and the logged values of the drives of a recording; return notes on them.

    Raises InputError if a log has no value in a drive.
    """
    tables = []
    for part in parts:
        if not part.images:
            raise InputError(f"{part.folder.name} has no images", "--split", "Pass other shares")
        times_s = np.array(part.times_s)
        since_start_s = times_s - recording.span_s()[0]
        stamps = part.folder / "image_02/timestamps.txt"
        stamps.write_bytes(format_times(since_start_s, DAY, 0.0))

        values = logged_values(recording.logs, times_s)
        for name, column in values.items():
            if not np.isfinite(column).any():
                problem = f"{part.folder.name} has no image with a known {name}"
                raise InputError(problem, fix="Check the times of the log, or pass --offset")
        for file, columns in VALUE_FILES.items():
            known = {name: values[name] for name in columns if name in values}
            if known:
                write_values(part.folder / file, known)
        tables.append(pd.DataFrame(values))
    table = pd.concat(tables)
    return [range_note(name, table[name].to_numpy()) for name in table]


def _find_horizon(
    finders: Mapping[Path, HorizonFinder], camera: Camera
) -> tuple[float | None, str, list[str]]:
    """Return the row of the horizon of all files, a note on it, and doubts.

    The row is None if too few images show a drive. Raises InputError if images are upside down.
    """
    rows = list[float]()
    for path, finder in finders.items():
        with error_context(path):
            row_of_file = finder.row()
        if row_of_file is not None:
            rows.append(row_of_file)
    doubts = list[str]()
    height = camera.size[0]
    if rows and max(rows) - min(rows) > MOVED * height:
        doubts.append(
            f"horizons of the files differ by {max(rows) - min(rows):.0f} rows of {height}: the "
            "camera was moved? Import the files separately"
        )

    headings = [heading for finder in finders.values() for heading in finder.headings]
    row = horizon_row(headings, camera)
    note = "horizon: not found, since too few images show a drive; assuming a level camera"
    if row is not None:
        note = f"horizon: row {row:.0f} of {height}"
    return row, note, doubts


def _check_disk(folder: Path, optics: Optics, frames: int, options: Options) -> None:
    """Print how much of the disk the images will take. Raises InputError if it is not free."""
    size = len(_encoded(optics.first, png=options.png)) * frames
    height, width = optics.camera.size
    needed = f"{frames} images of {width} x {height} pixels take about {size / 1e6:.0f} MB"
    print(needed, file=sys.stderr, flush=True)
    free = shutil.disk_usage(folder).free
    if size > free:
        problem = f"{needed}, but {free / 1e6:.0f} MB are free"
        raise InputError(problem, folder.parent.parent, "Free some, or use another disk")


def _encoded(image: np.ndarray, *, png: bool) -> bytes:
    """Return the content of the file of an image RGB uint8 [H,W,3]."""
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    suffix = ".png" if png else ".jpg"
    _, content = cv2.imencode(suffix, pixels, [] if png else JPEG)
    return content.tobytes()


def describe(path: Path) -> dict[str, Any]:
    """Return the name and the size of a file, or of the files in a folder."""
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file()]
    return {"name": path.name, "bytes": sum(file.stat().st_size for file in files)}
