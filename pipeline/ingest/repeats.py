"""Find images that a conversion to a higher rate repeats, and even the times of the others."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

# Longest run of repeats in seconds. If images stay unchanged for longer, the car stands.
RUN_S = 0.5
# Largest change of a repeat, relative to the changes around its run. Repeats have at most 0.2, and
# images of real streets at least 0.5.
UNCHANGED = 0.3
# Largest change in grey levels that may be noise of a video encoder.
NOISE = 0.7
# Change in grey levels that a key frame adds to the change of the image, at a low bit rate of a
# video encoder.
KEY_NOISE = 2.5
# Least share of repeats among the images of a video whose rate was converted.
SOME = 0.03
# Length in seconds of the windows in which times are evened.
EVEN_S = 3.0
# Largest difference between two deviations from even times, in steps of the grid. The grid alone
# explains 1, and jitter of the camera the excess.
JITTER = 1.3


def repeats(change: np.ndarray, key: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return which of N images repeat the one before, bool [N].

    Repeats are in runs of unchanged images, which are shorter than RUN_S and lie between changed
    images. `change` [N] is the mean difference from the image before in grey levels; it is infinite
    for the first image. `key` [N] is 1 for key frames and 0 for others.
    """
    result = np.zeros(len(change), bool)
    shown_s = np.append(time_s, time_s[-1])
    # A key frame may differ from the image that it repeats, so its noise is subtracted; but not if
    # all images are key frames. `least` has one more value, for the end of the video.
    without_key = np.where(key > key.min(), change - KEY_NOISE, change)
    least = np.append(without_key, np.inf)

    # In the first pass, at least one image of a run must be unchanged even with the noise of key
    # frames. If this finds repeats, a second pass also accepts a run that is only a key frame.
    for certain in (change, least):
        for first in np.flatnonzero(least[1:-1] < UNCHANGED * least[:-2]) + 1:
            end = np.searchsorted(shown_s, shown_s[first - 1] + RUN_S)
            for after in range(first + 1, end):
                run = slice(first, after)
                around = min(least[first - 1], least[after])
                if not NOISE < around < np.inf:
                    continue
                largest = max(least[run].max(), certain[run].min())
                if largest < UNCHANGED * around:
                    result[run] = True
        if result.mean() < SOME:
            break
    return result


def evened(time_s: np.ndarray, grid_s: float) -> np.ndarray:
    """Return the even times [F] of images that a conversion moved to a grid with step `grid_s`.

    The conversion moved each image to the next place of the grid. To undo this, a line is fitted to
    the times in each window of EVEN_S. The even time of an image is read from the line of one of
    the windows that contain the image. This is the window whose times deviate least from its line;
    of windows with similar deviations, it is the one whose middle is nearest to the image. So a
    window that contains a pause of the camera is not used. A time stays as it is if all windows
    deviate by more than the grid and the jitter of a camera explain.
    """
    half = round(EVEN_S / 2 / float(np.median(np.diff(time_s))))
    count = min(len(time_s), 2 * half + 1)
    windows = sliding_window_view(time_s, count)
    place = np.arange(count) - (count - 1) / 2

    # A line through each window, and its largest deviations.
    mean = windows.mean(axis=1)
    slope = windows @ place / max(place @ place, 1)
    deviation = windows - mean[:, None] - slope[:, None] * place
    spread = np.ptp(deviation, axis=1) / grid_s

    # Image number row + column is at place `column` of the window that begins at `row`.
    result = time_s.copy()
    least = np.full(len(time_s), np.inf)
    for column in range(count):
        cost = np.where(spread < JITTER, spread + abs(place[column]) / count, np.inf)
        rows = np.flatnonzero(cost < least[column : column + len(windows)])
        result[rows + column] = (mean + slope * place[column])[rows]
        least[rows + column] = cost[rows]
    return result
