"""Cap the depth of traffic (perception.reach)."""

import numpy as np

from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.ground_plane import ground_plane_depth


def limit_traffic_depth(depth: np.ndarray, cls: np.ndarray, camera: Camera, reach: float) -> None:
    """Cap the depth of traffic [H,W] in metres, in place.

    The cap is `reach` times the depth of flat ground at the lower edge of the traffic. Depth
    networks mistake smooth and bright surfaces, such as the side of a tanker, for the sky. The cap
    is wrong on slopes: traffic gets too little depth on descents steeper than `reach` allows, and
    on ascents the cap has no effect. A vehicle behind another one gets the depth of the nearer one.
    """
    traffic = np.isin(cls, classes.TRAFFIC)
    if traffic.any():
        ground_m = ground_plane_depth(cls, camera)
        depth[traffic] = np.minimum(depth[traffic], reach * ground_m[traffic])
