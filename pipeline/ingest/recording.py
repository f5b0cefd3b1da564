"""Open a recording: a user's video files or images with their times, the camera, and logs of the
car.
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
from pipeline.ingest.media import INEXACT, ImageFolder, VideoFiles, image_size, scan, upright
from pipeline.ingest.names import check_different, check_name, videos_in
from pipeline.ingest.repeats import evened, repeats
from pipeline.ingest.settings import RecordingOptions

Straighten = Callable[[np.ndarray], np.ndarray]  # removes the lens' distortion from an image


@dataclass
class Recording:
    """Images in order, without repeats, with their times, camera and logs."""

    source: ImageFolder | VideoFiles
    camera: Camera  # of complete images without distortion, at an unknown row of the horizon
    straighten: Straighten
    scan: pd.DataFrame  # a row per image, also of repeats; see :func:`pipeline.ingest.media.scan`
    kept: np.ndarray  # [F] places of the frames among the images
    times_s: np.ndarray  # [F]
    logs: Logs
    notes: list[str]  # for the user
    doubts: list[str]  # whether the files are one recording, in order

    @property
    def path(self) -> Path:
        """The folder of images, or the first video."""
        return self.source.path

    def frames(self, used: np.ndarray | None = None) -> Iterator[Frame]:
        """Yield number, time and straightened image RGB uint8 [H,W,3] of the frames; a second call
        starts again.

        `used`: a mask of the frames, bool [F]; None: all. Times are seconds since the first image,
        or those of a file.
        """
        numbers = {
            place: row for row, place in enumerate(self.kept.tolist()) if used is None or used[row]
        }
        for place, image in enumerate(self.source.images()):
            if (number := numbers.pop(place, None)) is not None:
                yield Frame(
                    number, float(self.times_s[number]), self.straighten(upright(image, self.path))
                )
                if not numbers:
                    return

    def resample(self, hz: float) -> None:
        """Keep only the frames nearest to a grid of `hz`; of a recording at about n times `hz`,
        every n-th frame.

        Raises InputError if the recording is slower than `hz` by more than RATE_TOLERANCE.
        """
        time_s = self.times_s
        apart = min(20, len(time_s) - 1)  # frames: steps may be uneven
        own_hz = apart / float(np.median(time_s[apart:] - time_s[:-apart])) if apart else hz
        ratio = own_hz / hz
        rates = f"the recording has {own_hz:.1f} frames/s, the model was fitted to {hz:.1f}"
        if ratio < 1 - RATE_TOLERANCE:
            raise InputError(rates, self.path, "Pass the right --fps, or another --model")
        if ratio > 1 + RATE_TOLERANCE:
            step_s = (
                round(ratio) if abs(ratio / round(ratio) - 1) < RATE_TOLERANCE / 2 else ratio
            ) / own_hz
            grid_s = np.arange(time_s[0], time_s[-1], step_s)
            rows = np.unique(np.searchsorted((time_s[1:] + time_s[:-1]) / 2, grid_s))
            self.kept = self.kept[rows]
            self.times_s = time_s[rows]
            self.notes.append(f"{len(rows)} of {len(time_s)} frames are used: {rates}")


def open_recording(
    paths: Sequence[Path], options: RecordingOptions, *, scanned: pd.DataFrame | None = None
) -> Recording:
    """Open a video file, several that follow each other, a folder of these, or one of images.

    All images are decoded once, unless they were `scanned` before. Raises InputError if there are
    no images or they have no usable times, if they are mirrored or of several sizes, if pixels are
    not square, for a lens that does not fit, and for logs of another time, before any image is
    decoded; DamagedFile if an image cannot be decoded, images are missing at the end, or timestamps
    do not increase.
    """
    if options.fps and options.times:
        raise InputError(
            "expected one source of the images' times, got two", fix="Pass --fps or --times"
        )
    logs = read_logs(options)
    source = _find_images(paths, options.fps)
    times_s = read_times(options.times) if options.times else None
    first_s, last_s = source.span_s() if times_s is None else times_s[[0, -1]]
    for log in logs.values():
        log.check_overlap(first_s, last_s)

    size = image_size(source)
    notes = [*source.notes]
    if scanned is None:
        scanned, found = scan(source)
        notes += found
    count = len(scanned)
    if count < INEXACT * source.stored - 1:
        notes.append(
            f"{count} of the file's {source.stored} frames are used: it was trimmed, and times "
            "begin there"
        )
    if times_s is None:
        times_s = source.times_s(scanned["time_s"].to_numpy())
    if len(times_s) != count:
        raise InputError(f"has {count} images, but {len(times_s)} times", source.path)

    kept = np.flatnonzero(
        ~repeats(scanned["change"].to_numpy(), scanned["key"].to_numpy(), times_s)
    )
    if len(kept) < count:
        notes.append(
            f"{count - len(kept)} of {count} images repeat the image before and are left out"
        )
        times_s = evened(times_s[kept], float(np.median(np.diff(times_s))))
    camera, straighten = _lens(options, size, source.path)
    return Recording(source, camera, straighten, scanned, kept, times_s, logs, notes, source.doubts)


def _find_images(paths: Sequence[Path], fps: float | None) -> ImageFolder | VideoFiles:
    """Return the images of a path, or of videos in order. Raises InputError."""
    for path in paths:
        if not path.exists():
            raise InputError("path is missing", path, "Pass a video, or a folder of images")
        check_name(path)
    if len(paths) > 1:
        if folder := next(filter(Path.is_dir, paths), None):
            raise InputError(
                "is a folder among several files", folder, "Pass videos in order, or one folder"
            )
        check_different(paths)
    if not paths[0].is_dir():
        return VideoFiles(paths, fps)

    videos, notes = videos_in(paths[0])
    for video in videos:
        check_name(video)
    source = VideoFiles(videos, fps) if videos else ImageFolder(paths[0], fps)
    source.notes[:0] = notes
    return source


def _lens(options: RecordingOptions, size: Size, path: Path) -> tuple[Camera, Straighten]:
    """Return the camera of straightened images, and the function that straightens them. Raises
    InputError.
    """
    if size[0] > size[1]:
        sizes = (
            f"images are taller than wide ({format_size(size)} pixels): is it rotated by 90 "
            "degrees?"
        )
        raise InputError(
            sizes, path, "Rotate it: ffmpeg -i in.mp4 -vf transpose=1 out.mp4 (or transpose=2)"
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
