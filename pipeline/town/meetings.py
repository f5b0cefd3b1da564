"""Where a route meets itself: recorded drives cross their own track and drive streets again."""

from dataclasses import dataclass

import numpy as np

from pipeline.town.route import STEP_M, Route

_APART_M = 60.0  # along the route; nearer points belong to the same stretch
_FAR_M = 1000.0  # stands for: nowhere
_MOUTH_M, _MOUTH_RAD = 9.0, np.deg2rad(30)


@dataclass(frozen=True)
class Meetings:
    """Per sample of the route: the distance to its nearest other stretch and to its nearest earlier one, [N] each, and
    whether it is at a junction of two stretches, bool [N]."""

    other_m: np.ndarray
    earlier_m: np.ndarray
    junction: np.ndarray


def find_meetings(route: Route) -> Meetings:
    """Compare each metre of the route with all others."""
    every = round(1 / STEP_M)
    s, xy, heading = route.s_m[::every], route.xy[::every], route.heading_rad[::every]
    meetings = np.zeros((3, len(s)))
    for i in range(len(s)):
        to = np.linalg.norm(xy - xy[i], axis=1)
        to[np.abs(s - s[i]) <= _APART_M] = _FAR_M
        across = np.abs(np.sin(heading - heading[i])) > np.sin(_MOUTH_RAD)
        meetings[:, i] = to.min(), to[: i + 1].min(), (across & (to < _MOUTH_M)).any()
    other, earlier, junction = (np.interp(route.s_m, s, row) for row in meetings)
    return Meetings(other, earlier, junction > 0)
