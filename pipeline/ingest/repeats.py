"""Find the images that a conversion to a higher frame rate repeats, and even the times of the
others.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

RUN_S = 0.5  # a longer run of unchanged images is a standing car
# change of a repeat, relative to those around its run: at most 0.2, on real streets at least 0.5
UNCHANGED = 0.3
# grey levels: of an encoder, and what its key frames add at a low bit rate
NOISE, KEY_NOISE = 0.7, 2.5
SOME = 0.03  # share of repeats in a conversion
# times are evened over it; largest deviations, in steps of the grid: cameras jitter
EVEN_S, JITTER = 3.0, 1.3


def repeats(change: np.ndarray, key: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return which of N images repeat the one before, bool [N]: in runs without change below RUN_S,
    between changes.

    `change` [N]: mean difference to the image before, in grey levels, infinite for the first. `key`
    [N]: 1: key frame.
    """
    result, shown_s = np.zeros(len(change), bool), np.append(time_s, time_s[-1])
    least = np.append(np.where(key > key.min(), change - KEY_NOISE, change), np.inf)
    for surely in (change, least):  # a key frame alone counts only among other repeats
        for first in np.flatnonzero(least[1:-1] < UNCHANGED * least[:-2]) + 1:
            for after in range(first + 1, np.searchsorted(shown_s, shown_s[first - 1] + RUN_S)):
                around, run = min(least[first - 1], least[after]), slice(first, after)
                if (
                    NOISE < around < np.inf
                    and max(least[run].max(), surely[run].min()) < UNCHANGED * around
                ):
                    result[run] = True
        if result.mean() < SOME:
            break
    return result


def evened(time_s: np.ndarray, grid_s: float) -> np.ndarray:
    """Return times [F] of regular images, which a conversion has moved to the next place of a grid
    with step `grid_s`.

    Each time is read from the line through a window of EVEN_S: the one with the least deviation
    and, of similar ones, that with the image nearest to its middle. So windows end where the camera
    paused. A time stays if all deviate by more than the grid explains.
    """
    count = min(len(time_s), 2 * round(EVEN_S / 2 / float(np.median(np.diff(time_s)))) + 1)
    windows, place = sliding_window_view(time_s, count), np.arange(count) - (count - 1) / 2
    mean, slope = windows.mean(axis=1), windows @ place / max(place @ place, 1)
    spread = np.ptp(windows - mean[:, None] - slope[:, None] * place, axis=1) / grid_s
    result, least = time_s.copy(), np.full(len(time_s), np.inf)
    for column in range(count):
        cost = np.where(spread < JITTER, spread + abs(place[column]) / count, np.inf)
        rows = np.flatnonzero(cost < least[column : column + len(windows)])
        result[rows + column] = (mean + slope * place[column])[rows]
        least[rows + column] = cost[rows]
    return result
