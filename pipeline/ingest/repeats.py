"""Find images that a conversion to a higher rate repeats, and even the times of the others."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

# Longest run in seconds of unchanged images that are repeats. A longer one is a standing car.
RUN_S = 0.5
# Largest change of a repeat, relative to the changes around its run. Repeats have at most 0.2, and
# images of real streets at least 0.5.
UNCHANGED = 0.3
# Largest change in grey levels that is noise of an encoder.
NOISE = 0.7
# What an encoder's key frames add to the change at a low bit rate, in grey levels.
KEY_NOISE = 2.5
# Least share of repeats in a conversion.
SOME = 0.03
# Seconds over which times are evened.
EVEN_S = 3.0
# Largest deviations of evened times in steps of the grid: cameras jitter.
JITTER = 1.3


def repeats(change: np.ndarray, key: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return which of N images repeat the one before, bool [N].

    They are in runs without change below RUN_S, between changes. `change` [N]: mean difference to
    the image before, in grey levels, infinite for the first. `key` [N]: 1: key frame.
    """
    result = np.zeros(len(change), bool)
    shown_s = np.append(time_s, time_s[-1])
    without_key = np.where(key > key.min(), change - KEY_NOISE, change)
    least = np.append(without_key, np.inf)

    # A key frame alone counts only if there are other repeats: in a second pass.
    for surely in (change, least):
        for first in np.flatnonzero(least[1:-1] < UNCHANGED * least[:-2]) + 1:
            end = np.searchsorted(shown_s, shown_s[first - 1] + RUN_S)
            for after in range(first + 1, end):
                run = slice(first, after)
                around = min(least[first - 1], least[after])
                if not NOISE < around < np.inf:
                    continue
                largest = max(least[run].max(), surely[run].min())
                if largest < UNCHANGED * around:
                    result[run] = True
        if result.mean() < SOME:
            break
    return result


def evened(time_s: np.ndarray, grid_s: float) -> np.ndarray:
    """Return the even times [F] of images that a conversion moved to a grid with step `grid_s`.

    It moved each to the next place of the grid. Each time is read from the line through a window of
    EVEN_S: the one with the least deviation and, of similar ones, that with the image nearest to
    its middle. So windows end where the camera paused. A time stays if all deviate by more than the
    grid explains.
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

    # Each image is at each place of some window.
    result = time_s.copy()
    least = np.full(len(time_s), np.inf)
    for column in range(count):
        cost = np.where(spread < JITTER, spread + abs(place[column]) / count, np.inf)
        rows = np.flatnonzero(cost < least[column : column + len(windows)])
        result[rows + column] = (mean + slope * place[column])[rows]
        least[rows + column] = cost[rows]
    return result
