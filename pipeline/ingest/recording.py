"""Open a recording: a user's videos or images with their times, the camera, and logs of the car.

A recording gets into data/ingest in three steps:

1. ``steer import`` opens it with :func:`open_recording`, which scans all of its images. It writes
   links to its files, and the scan, to a folder of data/raw, and cuts it into parts, each a drive
   of one split, in ``ingest.recordings`` of a preset.
2. Stage ingest opens each part in :mod:`pipeline.ingest.datasets.recording`, with the same function
   and without a second scan, and gets a :class:`pipeline.ingest.drive.Drive`: the camera, the
   frames of the part, and the values of the logs at their times.
3. :func:`pipeline.ingest.ingest_file.write_drive` crops and resizes the frames and writes
   data/ingest/<drive>.h5.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.params import RATE_TOLERANCE
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import Size, format_size
from pipeline.camera.lens import fisheye, pinhole, undistortion
from pipeline.ingest.log import Logs, read_logs, read_times
from pipeline.ingest.media import ImageFolder, VideoFiles, image_size
from pipeline.ingest.names import check_different, check_name, videos_in
from pipeline.ingest.repeats import evened, repeats
from pipeline.ingest.scan import scan
from pipeline.ingest.settings import RecordingOptions
from pipeline.ingest.video import INEXACT, upright

# Largest number of frames between the two frames from which a frame rate is measured. Single steps
# are uneven.
RATE_FRAMES = 20
# Frames per second that odometry and networks need. With 60 and 120, steps are so short that errors
# of tracking count, and the angle is worse.
USUAL_HZ = 10.0
# Least rate in frames per second that is reduced to about USUAL_HZ.
REDUCED_HZ = 15.0

# A function that removes the lens' distortion from an image.
Straighten = Callable[[np.ndarray], np.ndarray]


@dataclass
class Recording:
    """The frames of a recording, which are its images without repeats, its camera and its logs."""

    source: ImageFolder | VideoFiles
    # The camera of complete, straightened images. Its horizon is not known yet.
    camera: Camera
    straighten: Straighten
    # A row per image, also for repeats; see :func:`pipeline.ingest.scan.scan`.
    scan: pd.DataFrame
    # Places of the frames among the images [F].
    kept: np.ndarray
    # Times of the frames [F].
    times_s: np.ndarray
    logs: Logs
    # Notes for the user.
    notes: list[str]
    # Doubts whether the files are one recording, in order.
    doubts: list[str]

    @property
    def path(self) -> Path:
        """The folder of images, or the first video."""
        return self.source.path

    def frames(self, used: np.ndarray | None = None) -> Iterator[Frame]:
        """Yield the frames, or those of a mask bool [F]; a second call starts again.

        A frame has a number, a time and a straightened image RGB uint8 [H,W,3]. Times are seconds
        since the first image, or those in a file of times.
        """
        rows = np.arange(len(self.kept))
        if used is not None:
            rows = np.flatnonzero(used)
        row_at = dict(zip(self.kept[rows].tolist(), rows.tolist(), strict=True))

        for place, image in enumerate(self.source.images()):
            if place in row_at:
                row = row_at.pop(place)
                straight = self.straighten(upright(image, self.path))
                yield Frame(row, float(self.times_s[row]), straight)
                if not row_at:
                    return

    def recorded_hz(self) -> float:
        """Return the frames per second; 0 of a single frame."""
        apart = min(RATE_FRAMES, len(self.times_s) - 1)
        if not apart:
            return 0.0
        return apart / float(np.median(self.times_s[apart:] - self.times_s[:-apart]))

    def reduce(self) -> float | None:
        """Keep every n-th frame of a fast recording, about USUAL_HZ; return the rate, if any."""
        recorded_hz = round(self.recorded_hz(), 2)
        if recorded_hz < REDUCED_HZ:
            return None
        hz = round(recorded_hz / round(recorded_hz / USUAL_HZ), 3)
        self.resample(hz)
        return hz

    def resample(self, hz: float) -> None:
        """Keep only the frames nearest to a grid of `hz`.

        If the recording has about n times that rate, every n-th frame is kept. Raises InputError if
        the recording is slower than `hz` by more than RATE_TOLERANCE.
        """
        time_s = self.times_s
        recorded_hz = self.recorded_hz() or hz
        ratio = recorded_hz / hz
        if ratio < 1 - RATE_TOLERANCE:
            problem = f"has {recorded_hz:.1f} frames/s, expected {hz:.1f} or more"
            fix = "Pass the right --fps, a lower --hz, or a --model that was fitted to this rate"
            raise InputError(problem, self.path, fix)
        if ratio <= 1 + RATE_TOLERANCE:
            return

        # A whole number of frames per step of the grid keeps the steps even.
        every = ratio
        if abs(ratio / round(ratio) - 1) < RATE_TOLERANCE / 2:
            every = round(ratio)
        grid_s = np.arange(time_s[0], time_s[-1], every / recorded_hz)
        between_s = (time_s[1:] + time_s[:-1]) / 2
        rows = np.unique(np.searchsorted(between_s, grid_s))
        self.kept = self.kept[rows]
        self.times_s = time_s[rows]
        rates = f"the recording has {recorded_hz:.1f} a second, {hz:.1f} are used"
        self.notes.append(f"{len(rows)} of {len(time_s)} frames are used: {rates}")


def open_recording(
    paths: Sequence[Path], options: RecordingOptions, *, scanned: pd.DataFrame | None = None
) -> Recording:
    """Open a video, several videos that follow each other, a folder of videos, or one of images.

    All images are decoded once, unless `scanned` is the result of an earlier scan.

    Raises InputError, before any image is decoded, for logs of another time than the images, or if
    the images have no usable times. Raises InputError also if there are no images, if they are
    mirrored or have several sizes, if pixels are not square, or if the lens does not fit. Raises
    DamagedFile if an image cannot be decoded, if images are missing at the end, or if timestamps do
    not increase.
    """
    if options.fps and options.times:
        raise InputError(
            "expected one source of the images' times, got two", fix="Pass --fps or --times"
        )
    logs = read_logs(options)
    source = _find_images(paths, options.fps)
    notes = [*source.notes]

    # Faults of times and logs are found before any image is decoded.
    if options.times:
        times_s = read_times(options.times)
        first_s, last_s = times_s[[0, -1]]
    else:
        first_s, last_s = source.span_s()
    for log in logs.values():
        log.check_overlap(first_s, last_s)

    size = image_size(source)
    if scanned is None:
        scanned, scan_notes = scan(source)
        notes += scan_notes
    count = len(scanned)
    if count < INEXACT * source.stored - 1:
        notes.append(
            f"{count} of the file's {source.stored} frames are used: it was trimmed, and times "
            "begin there"
        )
    if not options.times:
        times_s = source.times_s(scanned["time_s"].to_numpy())
    if len(times_s) != count:
        raise InputError(f"has {count} images, but {len(times_s)} times", source.path)

    # A conversion to a higher rate repeats images. Only images that are no repeats become frames.
    is_repeat = repeats(scanned["change"].to_numpy(), scanned["key"].to_numpy(), times_s)
    kept = np.flatnonzero(~is_repeat)
    if len(kept) < count:
        notes.append(
            f"{count - len(kept)} of {count} images repeat the image before and are left out"
        )
        times_s = evened(times_s[kept], float(np.median(np.diff(times_s))))

    camera, straighten = _lens(options, size, source.path)
    recording = Recording(
        source, camera, straighten, scanned, kept, times_s, logs, notes, source.doubts
    )
    if options.hz:
        recording.resample(options.hz)
    return recording


def _find_images(paths: Sequence[Path], fps: float | None) -> ImageFolder | VideoFiles:
    """Return the images of a path, or of videos in order. Raises InputError."""
    for path in paths:
        if not path.exists():
            raise InputError("path is missing", path, "Pass a video, or a folder of images")
        check_name(path)
    if len(paths) > 1:
        for path in paths:
            if path.is_dir():
                raise InputError(
                    "is a folder among several files", path, "Pass videos in order, or one folder"
                )
        check_different(paths)
    if not paths[0].is_dir():
        return VideoFiles(paths, fps)

    videos, notes = videos_in(paths[0])
    for video in videos:
        check_name(video)
    source = VideoFiles(videos, fps) if videos else ImageFolder(paths[0], fps)
    source.notes = notes + source.notes
    return source


def _lens(options: RecordingOptions, size: Size, path: Path) -> tuple[Camera, Straighten]:
    """Return the camera of straightened images, and the function that straightens them.

    Raises InputError for images of a camera on its side, and for options that do not fit.
    """
    if size[0] > size[1]:
        raise InputError(
            f"images are taller than wide ({format_size(size)} pixels): is it rotated by 90 "
            "degrees?",
            path,
            "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)",
        )
    if options.distortion and options.fisheye:
        raise InputError(
            "expected one model of the lens, got two", fix="Pass --distortion or --fisheye"
        )
    if options.fisheye:
        return fisheye(size, options.fisheye, options.fov_deg, options.K)
    camera = pinhole(size, options.fov_deg, options.K)
    if options.distortion:
        return camera, undistortion(camera, options.distortion)
    return camera, lambda image: image
