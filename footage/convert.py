"""Convert a recording, once, to drives in KITTI raw's layout.

A recording is a video, several that follow each other, or a folder of images, with logs of the car.
Its drives are ``NAME/NAME_drive_0001_sync`` and so on, with the files ``image_02/data/%010d.jpg``,
``image_02/timestamps.txt``, ``motion.csv`` and ``steering.csv``. Frame numbers are left out where
images are missing. The drives share the calibration in ``NAME/``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
from tqdm import tqdm

from footage.borders import BorderFinder
from footage.clips import describe_clips, find_gaps, list_clips
from footage.lens import border_doubt, open_lens
from footage.log import Log, read_logs, read_times
from footage.settings import Options
from footage.video import Images, check_numbers, open_images
from pipeline.base.errors import InputError, error_context
from pipeline.camera.camera import Camera
from pipeline.ingest.calibration import write_calibration
from pipeline.ingest.clocks import is_gap
from pipeline.ingest.packets import VALUE_FILES, format_times, write_values
from pipeline.motion.horizon import HeadingFinder, compute_horizon

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
# Most frame numbers that are left out at a gap in time. It is the longest horizon of a target, so
# that no frame before a gap has a target after it; each number is a line of timestamps.txt.
MOST_LEFT_OUT = 10_000


class Recording(NamedTuple):
    """Files that follow each other, the times of their images, and the logs of the car."""

    files: list[Images]
    times_s: np.ndarray  # of all images [N]
    logs: Mapping[str, Log]

    @property
    def step_s(self) -> float:
        """The median time between two images."""
        return float(np.median(np.diff(self.times_s)))

    def find_stride(self, hz: float) -> int:
        """Return n, if every n-th image becomes one of about `hz` frames a second."""
        return max(1, round(1 / (self.step_s * hz)))

    def read_images(self, wanted: np.ndarray) -> Iterator[tuple[Path, int, np.ndarray]]:
        """Yield the images that are `wanted`, bool [N], with their file and their place."""
        start = 0
        for file in self.files:
            stop = start + file.count
            for place, image in file.read_images(wanted[start:stop]):
                yield file.path, start + place, image
            start = stop


@dataclass
class Drive:
    """A drive that is being written."""

    folder: Path
    # Usual time in seconds from one image to the next.
    step_s: float
    # Times of the written images in the recording.
    times_s: list[float] = field(default_factory=list)
    # Their frame numbers.
    numbers: list[int] = field(default_factory=list)

    def write_image(self, image: np.ndarray, time_s: float, *, png: bool) -> None:
        """Write the next image, RGB uint8 [H,W,3]."""
        number = self._next_number(time_s)
        suffix = ".png" if png else ".jpg"
        path = self.folder / f"image_02/data/{number:010d}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        _, content = cv2.imencode(suffix, pixels, [] if png else JPEG)
        path.write_bytes(content.tobytes())
        self.times_s.append(time_s)
        self.numbers.append(number)

    def _next_number(self, time_s: float) -> int:
        """Return the frame number of an image that follows the last one.

        Later stages take frames with neighbouring numbers for consecutive ones. After a gap in
        time, the numbers of the images that are missing are therefore left out, as in KITTI.
        """
        if not self.numbers:
            return 0
        step_s = time_s - self.times_s[-1]
        steps = 1
        if is_gap(step_s, self.step_s):
            left_out = round(step_s / self.step_s) - 1
            steps += min(left_out, MOST_LEFT_OUT)
        return self.numbers[-1] + steps

    def format_times(self, start_s: float) -> bytes:
        """Return the content of timestamps.txt, where time 0 is that of `start_s`.

        Line i belongs to frame i. The numbers that are left out have lines, too, whose times are
        interpolated.
        """
        lines = np.arange(self.numbers[-1] + 1)
        times_s = np.interp(lines, self.numbers, self.times_s)
        return format_times(times_s - start_s, DAY, 0.0)

    def note_gaps(self) -> list[str]:
        """Return a note if frame numbers are left out."""
        rows = np.flatnonzero(np.diff(self.numbers) > 1)
        if not len(rows):
            return []
        steps_s = np.diff(self.times_s)
        row = rows[np.argmax(steps_s[rows])]
        return [
            f"{self.folder.name}: gaps in time: {len(rows)}, the longest of {steps_s[row]:.1f} s "
            f"after frame {self.numbers[row]}; the next frame is {self.numbers[row + 1]}, so that "
            "nothing crosses the gap"
        ]


class Converted(NamedTuple):
    """What a conversion wrote."""

    drives: list[Drive]
    camera: Camera
    # Frames per second.
    hz: float
    # Lines for the user, of which those of doubts begin with DOUBT.
    notes: list[str]
    # Content of import.json.
    record: dict[str, Any]


def open_recording(paths: Sequence[Path], options: Options) -> Recording:
    """Open a video, several that follow each other, or a folder of images, without decoding them.

    Raises InputError if files are missing, have no times or are passed twice, or a log is faulty or
    of another time.
    """
    if options.fps and options.times:
        problem = "expected one source of the images' times, got two"
        raise InputError(problem, fix="Pass --fps or --times")
    logs = read_logs(options)
    targets = [path.resolve() for path in paths]
    for path, target in zip(paths, targets, strict=True):
        if targets.count(target) > 1:
            raise InputError("is passed twice", path, "Pass each file once")
    files = [open_images(path) for path in paths]
    count = sum(file.count for file in files)
    if count < 2:
        raise InputError("has fewer than 2 images", paths[0])
    if options.times:
        times_s = read_times(options.times)
        if len(times_s) != count:
            raise InputError(f"has {count} images, but {len(times_s)} times", paths[0])
    elif options.fps:
        for file in files:
            check_numbers(file.files)
        times_s = np.arange(count) / options.fps
    else:
        times_s = _join_times(files)
    for log in logs.values():
        log.check_overlap(times_s[0], times_s[-1], files=len(files))
    return Recording(files, times_s, logs)


def _join_times(files: Sequence[Images]) -> np.ndarray:
    """Return the times of all images by the files' own times.

    Each file begins one step after the last image of the file before. Raises InputError.
    """
    times_s = list[np.ndarray]()
    begin_s = 0.0
    for file in files:
        if file.times_s is None:
            problem = "images have no times"
            if file.time_count:
                word = "time" if file.time_count == 1 else "times"
                problem = f"{file.count} images, {file.time_count} {word}"
            raise InputError(problem, file.path, "Pass --fps N, or --times FILE")
        times_s.append(begin_s + file.times_s)
        begin_s += file.times_s[-1] + np.median(np.diff(file.times_s))
    return np.concatenate(times_s)


def convert(
    folder: Path,
    name: str,
    recording: Recording,
    options: Options,
    *,
    shares: Sequence[float] = (100.0,),
    hz: float = USUAL_HZ,
) -> Converted:
    """Write the drives of a recording, and their calibration, to the new `folder`.

    The recording is cut into parts with `shares` of its time, in %, and each part is a drive. Of
    the images, every n-th is written, so that about `hz` a second remain.

    Raises InputError if images have several sizes, the lens does not fit, a part is too short, a
    log has no value, or images are upside down. Raises DamagedFile if an image cannot be decoded,
    images are missing at the end, or times do not increase.
    """
    folder.mkdir(parents=True)
    parts = _divide_parts(recording, shares, hz)
    first = recording.files[0]
    lens = open_lens(options, first.read_size(), first.path)
    finders = {file.path: HeadingFinder(lens.camera) for file in recording.files}
    borders = BorderFinder()

    numbers = range(1, len(shares) + 1)
    step_s = recording.step_s * recording.find_stride(hz)
    drives = [Drive(folder / f"{name}_drive_{number:04d}_sync", step_s) for number in numbers]
    is_written = parts >= 0
    frames = int(is_written.sum())
    with tqdm(total=frames, desc="convert", unit=" images", disable=None) as bar:
        for path, place, image in recording.read_images(is_written):
            frame = lens.to_frame(image, path)
            drive = drives[parts[place]]
            drive.write_image(frame, recording.times_s[place], png=options.png)
            finders[path].add_image(frame)
            borders.add_image(image)
            bar.update()

    clips = list_clips(recording.files, recording.times_s)
    notes = describe_clips(clips)
    if not options.times:
        notes += find_gaps(clips)
    notes += _write_values(recording, drives)
    crop = borders.find_crop()
    if crop:
        notes.append(border_doubt(options, crop))

    # The files have one horizon. Each alone must not be upside down.
    headings = []
    for path, finder in finders.items():
        with error_context(path):
            compute_horizon(finder.headings, lens.camera)
        headings += finder.headings
    horizon = compute_horizon(headings, lens.camera)
    if horizon is None:
        notes.append(
            "horizon: not found, since too few images show a drive; assuming a level camera"
        )
    else:
        notes.append(f"horizon: row {horizon:.0f} of {lens.camera.size[0]}")
    camera = replace(lens.camera, horizon=horizon).at_height(options.camera_height_m)
    write_calibration(folder, camera)
    record = {
        "version": version("semantic-steering"),
        "options": options.model_dump(mode="json", by_alias=True, exclude_defaults=True),
        "recordings": [describe_file(file.path) for file in recording.files],
    }
    return Converted(drives, camera, hz=1 / step_s, notes=notes, record=record)


def _divide_parts(recording: Recording, shares: Sequence[float], hz: float) -> np.ndarray:
    """Return the part of each image of a recording, int [N]; -1 for images that are not written.

    Raises InputError if a part has fewer than two images.
    """
    times_s = recording.times_s
    length_s = times_s[-1] - times_s[0]
    ends_s = times_s[0] + length_s * np.cumsum(shares)[:-1] / sum(shares)
    parts = np.searchsorted(ends_s, times_s, side="right")
    # A part begins where the one before ends, and ends before the gap.
    ends_s = np.append(ends_s - GAP_S, np.inf)
    is_written = np.arange(len(times_s)) % recording.find_stride(hz) == 0
    parts[~is_written | (times_s >= ends_s[parts])] = -1
    for number, share in enumerate(shares):
        if (parts == number).sum() < 2:
            problem = f"the part of {share:g} % has fewer than 2 images ({length_s:.1f} s in all)"
            gap = f"{GAP_S:g} s are left out between parts"
            raise InputError(problem, "--split", f"Pass a longer recording, or other shares: {gap}")
    return parts


def _write_values(recording: Recording, drives: Sequence[Drive]) -> list[str]:
    """Write the times and the logged values of the drives of a recording; return notes on them.

    Raises InputError if a log has no value in a drive.
    """
    tables = []
    notes = []
    for drive in drives:
        times_s = np.array(drive.times_s)
        stamps = drive.format_times(recording.times_s[0])
        (drive.folder / "image_02/timestamps.txt").write_bytes(stamps)
        notes += drive.note_gaps()

        values = {name: log.interpolate(times_s) for name, log in recording.logs.items()}
        for name, column in values.items():
            if not np.isfinite(column).any():
                problem = f"{drive.folder.name} has no image with a known {name}"
                raise InputError(problem, fix="Check the times of the log, or pass --offset")
        for file, columns in VALUE_FILES.items():
            logged = {name: values[name] for name in columns if name in values}
            if logged:
                write_values(drive.folder / file, drive.numbers, logged)
        tables.append(pd.DataFrame(values))

    table = pd.concat(tables)
    for name in table:
        column = table[name].dropna()
        known = f"{name} is known at {len(column):,} of {len(table):,} images"
        notes.append(f"{known}: {column.min():z.3f} to {column.max():z.3f}")
    return notes


def describe_file(path: Path) -> dict[str, Any]:
    """Return the name and the size of a file, or of the files in a folder."""
    files = [path]
    if path.is_dir():
        files = [file for file in path.iterdir() if file.is_file()]
    return {"name": path.name, "bytes": sum(file.stat().st_size for file in files)}
