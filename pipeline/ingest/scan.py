"""Scan a recording: decode all images once to find repeats, stereo images and other problems."""

from pathlib import Path

import numpy as np
import pandas as pd
from av.video.reformatter import VideoReformatter
from tqdm import tqdm

from pipeline.base.errors import InputError
from pipeline.camera.images import Size, format_size
from pipeline.ingest.media import ImageFolder, VideoFiles
from pipeline.ingest.stereo import likeness, refuse_stereo

# Width in pixels to which images are shrunk before they are compared, which averages noise.
THUMB_PX = 64
# Images whose number is a multiple of this are searched for black bars, and for the two images of a
# stereo camera.
STRIDE = 20
# Quantile of the values of a row's or a column's pixels that is called its level.
MOST = 0.95
# Largest level, in grey levels, of a row or column of a black bar.
BAR = 8
# Least level, in grey levels, of the image beside a black bar.
LIT = 32
# Distance in pixels from a black bar's edge at which the level of the image is read. Bars of this
# width or less are noise.
BESIDE_PX = 2


def scan(source: ImageFolder | VideoFiles) -> tuple[pd.DataFrame, list[str]]:
    """Return a row for each image of a recording, and notes for the user.

    Column time_s is the image's time stamp, or NaN. Columns change and key are arguments of
    :func:`pipeline.ingest.repeats.repeats`. Raises InputError if the size changes, or if images are
    those of a stereo camera.
    """
    shrink = VideoReformatter()
    rows = []
    likenesses = list[tuple[float, float]]()
    before = np.array(np.inf)
    size: Size = (0, 0)
    for number, image in enumerate(tqdm(source.images(), "scan", unit=" images", disable=None)):
        if number == 0:
            size = (image.height, image.width)
            thumb_height = max(1, image.height * THUMB_PX // image.width)
            thumb_width = min(THUMB_PX, image.width)
            lightest = np.zeros(size, np.uint8)
        if (image.height, image.width) != size:
            raise InputError(
                f"image {number} has {image.width} x {image.height} pixels (expected "
                f"{format_size(size)}, as the first one)",
                source.path,
                "Images of one recording have one size",
            )

        # Compare each image with the one before.
        thumb = shrink.reformat(image, thumb_width, thumb_height, "gray", interpolation="AREA")
        grey = thumb.to_ndarray().astype(np.float32)
        change = np.abs(grey - before).mean()
        rows.append((image.time, change, image.key_frame, image.interlaced_frame))
        before = grey

        if number % STRIDE == 0:
            sample = image.to_ndarray(format="gray")
            lightest = np.maximum(lightest, sample)
            likenesses.append(likeness(sample))

    refuse_stereo(np.array(likenesses), source.path)
    table = pd.DataFrame(np.array(rows, float), columns=["time_s", "change", "key", "interlaced"])
    notes = list[str]()
    if table.pop("interlaced").any():
        fix = f"ffmpeg -i {source.path.name} -vf bwdif=send_frame progressive.mp4"
        notes.append(f"interlaced images falsify the motion. Deinterlace them: {fix}")
    return table, notes + _black_bars(lightest, source.path)


def _black_bars(lightest: np.ndarray, path: Path) -> list[str]:
    """Return a note on black bars on two opposite sides of images.

    `lightest` [H,W]: the lightest value of each pixel.
    """
    rows = _between_bars(np.quantile(lightest, MOST, axis=1))
    columns = _between_bars(np.quantile(lightest, MOST, axis=0))
    if (len(rows), len(columns)) == lightest.shape:
        return []
    crop = f"crop={len(columns)}:{len(rows)}:{columns.start}:{rows.start}"
    return [
        f"black bars make the speed wrong. Crop the images: ffmpeg -i {path.name} -vf {crop} "
        f"cropped.mp4, cx - {columns.start} and cy - {rows.start} in --K"
    ]


def _between_bars(level: np.ndarray) -> range:
    """Return the range of rows, or of columns, between two bars.

    `level` has the level of each row. All rows are returned if there are no two bars.
    """
    complete = range(len(level))
    light = np.flatnonzero(level > BAR)
    if not len(light):
        return complete
    # There is a bar on each side, and each is wider than noise.
    first = int(light[0])
    last = int(light[-1])
    if first <= BESIDE_PX or last >= len(level) - 1 - BESIDE_PX:
        return complete
    # A bar ends abruptly: the image beside it is light.
    if min(level[first + BESIDE_PX], level[last - BESIDE_PX]) <= LIT:
        return complete
    return range(first, last + 1)
