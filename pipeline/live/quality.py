"""How certain measured motion is: the share of frames, the scale of depth by the road, pitch, and the focal length."""

import math
from collections.abc import Generator
from itertools import islice
from typing import Any

import numpy as np

from pipeline.live.frame_state import FrameState
from pipeline.live.source import Source
from pipeline.motion.visual import Odometry

FOCAL_TOLERANCE, FOCAL_SIGMAS = 0.18, 5.0  # smaller deviations are not reported: of the logarithm, and in sigmas
MIN_ROAD = 0.5  # share of frames with a road, below which the scale is called uncertain
MAX_SPREAD = 0.15  # of the road's heights


class Quality:
    """Collects the quality of a run; frames come in order."""

    def __init__(self, odometry: Odometry, source: Source) -> None:
        self._odometry, self._source = odometry, source
        self._heights_m: list[float] = []

    def watch(self, frames: Generator[FrameState], count: int | None) -> Generator[FrameState]:
        """Yield the first `count` frames, whose motion is measured when they come; None: all."""
        for frame in islice(frames, count):
            self._heights_m.append(self._odometry.road.height_m)
            yield frame

    def summary(self) -> dict[str, Any]:
        """Return numbers for quality.json; None where unknown."""
        heights_m = np.array(self._heights_m)
        known = heights_m[np.isfinite(heights_m)]
        gradient, information = self._odometry.focal
        summary: dict[str, Any] = {
            "camera_height_m": self._source.height_m,
            "road_frames": float(np.isfinite(heights_m).mean()),
            "road_height_m": float(np.median(known)) if len(known) else None,
            "road_height_spread": float(known.std() / known.mean()) if len(known) else None,
            "pitch_deg": math.degrees(math.atan(self._odometry.road.slope)),
            "focal_ratio": math.exp(float(np.clip(-gradient / information, -1, 1))) if information > 0 else None,
            "focal_sigma": float(information**-0.5) if information > 0 else None,
        }
        return summary | {"remarks": _remarks(summary)}


def _remarks(summary: dict[str, Any]) -> list[str]:
    """Return what a user should know before using the numbers."""
    height_m, road_m, spread = (summary[key] for key in ("camera_height_m", "road_height_m", "road_height_spread"))
    if road_m is None or summary["road_frames"] < MIN_ROAD:
        scale = f"road found in {summary['road_frames']:.0%} of the frames: speed and curvature are uncertain"
    elif height_m is None:
        scale = (
            f"the encoder's depth, which puts the camera {road_m:.2f} m above the road (spread {spread:.0%}). Measure "
            "it and pass --camera-height: speed is proportional to it"
        )
    else:
        scale = f"the camera's height of {height_m:.2f} m over the road (spread {spread:.0%})"
        scale += ", uncertain" if spread > MAX_SPREAD else ""
    remarks = [f"scale: {scale}"]
    ratio, sigma = summary["focal_ratio"], summary["focal_sigma"]
    if ratio is None or sigma > FOCAL_TOLERANCE / 2:
        remarks.append("focal length: too few turns to check it")
    elif abs(math.log(ratio)) > max(FOCAL_TOLERANCE, FOCAL_SIGMAS * sigma):
        direction = "short (pass a smaller --fov)" if ratio > 1 else "long (pass a larger --fov)"
        remarks.append(f"focal length: turns of the camera show that it is too {direction}")
    else:
        remarks.append("focal length: agrees with the turns of the camera")
    return remarks
