"""Compute oxts packets from speed and yaw rate: level ground, no side slip, positions by integration."""

import numpy as np

from pipeline.kitti.oxts import GRAVITY_MPS2, level_columns, make_rows
from pipeline.recording.track import Rates


def packets(rates: Rates, time_s: np.ndarray) -> np.ndarray:
    """Return the packets [F,30] of images at `time_s` [F], ascending, within the motion's times.

    Rates are interpolated linearly; heading and position are their integrals from the first sample. Height, roll,
    pitch, accuracies and receiver modes are unknown and 0.
    """
    from scipy.integrate import cumulative_trapezoid

    time_s = np.clip(time_s, rates.time_s[0], rates.time_s[-1])
    nodes_s = np.union1d(time_s, rates.time_s)
    speed, yaw_rate = (np.interp(nodes_s, rates.time_s, rate) for rate in (rates.speed_mps, rates.yaw_rate_radps))
    heading = rates.heading_rad + cumulative_trapezoid(yaw_rate, nodes_s, initial=0)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    xy = cumulative_trapezoid(velocity, nodes_s, axis=0, initial=0)

    at = np.concatenate([[0], np.searchsorted(nodes_s, time_s)])  # the first sample has a known position
    speed, yaw_rate = speed[at], yaw_rate[at]
    left = speed * yaw_rate
    forward = np.concatenate([[0.0], np.gradient(speed[1:], time_s) if len(time_s) > 1 else np.zeros(1)])
    level = level_columns(xy[at], heading[at], speed, forward, left, yaw_rate, rates.latitude_deg, rates.longitude_deg)
    return make_rows(len(at), **level, ax=forward, ay=left, az=GRAVITY_MPS2)[1:]
