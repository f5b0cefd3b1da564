"""Cap the depth of traffic (perception.reach)."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.ground_plane import ground_plane_depth


def limit_traffic_depth(depth: np.ndarray, cls: np.ndarray, camera: Camera, reach: float) -> None:
    """Cap the depth of traffic [H,W] in metres, in place.

    The cap is `reach` times the depth of flat ground at the lower edge of the traffic. It is needed
    since depth networks mistake smooth and bright surfaces, such as the side of a tanker, for the
    sky. The cap is wrong on slopes: on descents steeper than `reach` allows, the depth of traffic
    becomes too small, and on ascents, the cap has no effect. If a vehicle hides the lower edge of
    another vehicle, the cap of both is that of the nearer vehicle.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, camera)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
