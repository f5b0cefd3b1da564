"""A journey as a real drive recorded it: the road is laid along the driven track.

The track is the integral of forward speed along heading, so that the road bends as the label says at any speed. The
recorded velocities to the north and east are noise when the car stands and would bend it; tracks of either kind are a
few metres off latitude and longitude at a drive's end, and both come back to a street within a metre or so.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.oxts import AF, VF, YAW
from pipeline.town.body import level
from pipeline.town.edges import BARRIER_M
from pipeline.town.journey import Journey
from pipeline.town.junctions import arm_is_clear, turn_arms
from pipeline.town.motion import Motion
from pipeline.town.recording import Recording
from pipeline.town.route import AHEAD_M, BEHIND_M, STEP_M, Arm, Route, unit

_SMOOTH_M = 1.5  # standard deviation: takes off the noise; from 2.5 on, sharp turns lose their sharpness
_FADE_M = 8.0  # over which a bend ends that a recording breaks off in
_END_M = 4.0  # of the track, whose curvature is that of its end
_BEND_1PM = 0.015  # a turn at a junction bends more than this throughout,
_TURN_RAD = (np.deg2rad(55), np.deg2rad(120))  # turns by this much
_TURN_M = 40.0  # and is no longer
_BESIDE_M = 2.0  # a car farther from its road has turned round in several moves


def replay(drive: str, recording: Recording, rng: np.random.Generator, lane_m: float) -> Journey:
    """Lay a road along the track of `drive` and return the drive along it: place, heading, stops, reversing as driven.

    Raises InputError if the car reverses onto another track than its own.
    """
    time_s, speed, heading = recording.time_s, recording.rows[:, VF], np.unwrap(recording.rows[:, YAW])
    track = _integral(np.column_stack([speed * np.cos(heading), speed * np.sin(heading), speed]), time_s)
    xy, driven = track[:, :2], track[:, 2]
    route, s = _lay_road(xy, heading, driven, lane_m)
    beside = np.linalg.norm(xy - route.at(s)[0], axis=1)
    if beside.max() > _BESIDE_M:
        i = int(np.argmax(beside > _BESIDE_M))
        raise InputError(
            f"{drive} turns round in several moves: at frame {list(recording.packets)[i]} it is {beside[i]:.1f} m off "
            "the road laid along its track, which cannot be replayed: take the drive out of ingest.drives"
        )
    junctions, arms = [], []
    for start, end in _turns(route):
        ways = [arm for arm in turn_arms(route, start, end, rng) if _is_free(arm, route)]
        arms += ways
        junctions += [(start + end) / 2] * bool(ways)
    route = replace(route, junctions_m=tuple(junctions), arms=tuple(arms))
    return Journey(route, Motion(time_s, s, speed, recording.rows[:, AF]), level(len(s)), xy, heading)


def _integral(rate: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Return the integral [F,N] of `rate` [F,N] over time, from 0."""
    steps = (rate[1:] + rate[:-1]) / 2 * np.diff(time_s)[:, None]
    return np.concatenate([np.zeros((1, rate.shape[1])), np.cumsum(steps, axis=0)])


def _lay_road(xy: np.ndarray, heading: np.ndarray, driven: np.ndarray, lane_m: float) -> tuple[Route, np.ndarray]:
    """Return a smooth road along the track xy [F,2], longer at both ends, and s [F] of its frames.

    Frames count where the distance driven (less when reversing) reaches ground that it has not reached before, so that
    standing and reversing do not fold the road.
    """
    rearmost, foremost = np.minimum.accumulate(driven), np.maximum.accumulate(driven)
    new = np.concatenate([[True], (driven[1:] < rearmost[:-1]) | (driven[1:] > foremost[:-1])])
    order = np.flatnonzero(new)[np.argsort(driven[new])]
    grid = np.arange(driven[order[0]], driven[order[-1]] + STEP_M, STEP_M)
    x, y, yaw = (np.interp(grid, driven[order], values[order]) for values in (*xy.T, heading))
    track = np.stack([x, y], axis=-1)

    spare = 4 * round(_SMOOTH_M / STEP_M)  # samples that smoothing takes off at each end
    end = min(round(_END_M / STEP_M), len(grid) - 1)
    behind = _run_out(yaw[0] + np.pi, (yaw[0] - yaw[end]) / _END_M, BEHIND_M + spare * STEP_M)[::-1]
    ahead = _run_out(yaw[-1], (yaw[-1] - yaw[-1 - end]) / _END_M, AHEAD_M + spare * STEP_M)
    line = np.concatenate([track[0] + behind, track, track[-1] + ahead])
    kernel = np.exp(-((np.arange(-spare, spare + 1) * STEP_M / _SMOOTH_M) ** 2) / 2)
    line = np.stack([np.convolve(line[:, axis], kernel / kernel.sum(), "valid") for axis in (0, 1)], axis=-1)

    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    first = len(behind) - spare  # of the line's samples, the track's first
    s_of_grid = length[first : first + len(grid)] - length[first]
    s = np.arange(0.0, length[-1], STEP_M)
    line = np.stack([np.interp(s, length, line[:, axis]) for axis in (0, 1)], axis=-1)
    along = np.gradient(line, axis=0)
    road_heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    route = Route(s - length[first], line, road_heading, np.gradient(road_heading) / STEP_M, lane_m, (), ())
    return route, np.interp(driven, grid, s_of_grid)


def _run_out(heading: float, curvature_1pm: float, length_m: float) -> np.ndarray:
    """Return points [N,2] every STEP_M from the origin on, along a bend that fades to a straight."""
    u = (np.arange(round(length_m / STEP_M)) + 0.5) * STEP_M
    bent = np.minimum(u, _FADE_M)
    heading_at = heading + curvature_1pm * (bent - bent**2 / (2 * _FADE_M))
    return np.cumsum(unit(heading_at) * STEP_M, axis=0)


def _turns(route: Route) -> list[tuple[float, float]]:
    """Return s of start and end of the bends that look like turns at a junction."""
    side = np.sign(route.curvature_1pm) * (np.abs(route.curvature_1pm) > _BEND_1PM)
    edges = np.flatnonzero(np.diff(side)) + 1
    turns = []
    for start, end in pairwise(edges):
        turned = abs(route.heading_rad[end] - route.heading_rad[start])
        if _TURN_RAD[0] < turned < _TURN_RAD[1] and (end - start) * STEP_M < _TURN_M:
            turns.append((float(route.s_m[start]), float(route.s_m[end])))
    return turns


def _is_free(arm: Arm, route: Route) -> bool:
    """Neither the arm nor the barrier across its mouth is in the way of any stretch of the route."""
    out = unit(arm.heading_rad)
    edge = route.lane_m + 0.25
    along, across = np.meshgrid(edge + np.linspace(*BARRIER_M, 4), np.linspace(-arm.half_m, arm.half_m, 9))
    barrier = arm.xy + along[..., None] * out + across[..., None] * [-out[1], out[0]]
    to_route = np.linalg.norm(barrier.reshape(-1, 1, 2) - route.xy, axis=-1)
    return arm_is_clear(arm, route.xy) and bool(to_route.min() > _BESIDE_M + 1.0)
