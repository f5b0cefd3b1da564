"""Replay a real drive: lay a road along its track.

The track is the integral of forward speed along heading, so that the road's curvature matches the label at any speed.
The recorded velocities north and east are noise at standstill and would bend it. Both tracks are a few metres off
latitude and longitude at a drive's end, and return to a street within about a metre.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from pipeline.base.errors import InputError
from pipeline.kitti.oxts import AF, VF, YAW
from pipeline.sample.manoeuvres import arm_is_clear, turn_arms
from pipeline.sample.motion import Body, Journey, Travel
from pipeline.sample.oxts import Recording
from pipeline.sample.route import AHEAD_M, BEHIND_M, STEP_M, Arm, Route, unit
from pipeline.sample.street import BARRIER_M

_SMOOTH_M = 1.5  # standard deviation: removes noise; from 2.5 on, sharp turns are flattened
_FADE_M = 8.0  # a bend at the end of a recording fades out over this length
_END_M = 4.0  # stretch that determines the curvature of the track's end
_BEND_1PM = 0.015  # turns at junctions have at least this curvature throughout,
_TURN_RAD = (np.deg2rad(55), np.deg2rad(120))  # this angle
_TURN_M = 40.0  # and at most this length
_BESIDE_M = 2.0  # farther off its road, a car has turned round in several moves


def replay(drive: str, recording: Recording, rng: np.random.Generator, lane_m: float) -> Journey:
    """Lay a road along the track of `drive` and return its journey, with stops and reversing.

    Raises InputError if the car reverses off its own track.
    """
    time_s, speed, heading = recording.time_s, recording.rows[:, VF], np.unwrap(recording.rows[:, YAW])
    track = _integral(np.column_stack([speed * np.cos(heading), speed * np.sin(heading), speed]), time_s)
    xy, driven = track[:, :2], track[:, 2]
    route, s = _lay_road(xy, heading, driven, lane_m)
    beside = np.linalg.norm(xy - route.at(s)[0], axis=1)
    if beside.max() > _BESIDE_M:
        i = int(np.argmax(beside > _BESIDE_M))
        raise InputError(
            f"drive turns round in several moves, which cannot be replayed: frame {list(recording.packets)[i]} is "
            f"{beside[i]:.1f} m off the road along its track",
            drive,
            "Take the drive out of ingest.drives",
        )
    junctions, arms = [], []
    for start, end in _turns(route):
        ways = [arm for arm in turn_arms(route, start, end, rng) if _is_free(arm, route)]
        arms += ways
        junctions += [(start + end) / 2] * bool(ways)
    route = replace(route, junctions_m=tuple(junctions), arms=tuple(arms))
    return Journey(route, Travel(time_s, s, speed, recording.rows[:, AF]), Body(*np.zeros((3, len(s)))), xy, heading)


def _integral(rate: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Integrate `rate` [F,N] over time; return [F,N], from 0."""
    steps = (rate[1:] + rate[:-1]) / 2 * np.diff(time_s)[:, None]
    return np.concatenate([np.zeros((1, rate.shape[1])), np.cumsum(steps, axis=0)])


def _lay_road(xy: np.ndarray, heading: np.ndarray, driven: np.ndarray, lane_m: float) -> tuple[Route, np.ndarray]:
    """Return a smooth road along the track xy [F,2], extended at both ends, and s [F] of its frames.

    Only frames that extend the range of the distance driven (which falls in reverse) count, so that standing and
    reversing do not fold the road.
    """
    rearmost, foremost = np.minimum.accumulate(driven), np.maximum.accumulate(driven)
    new = np.concatenate([[True], (driven[1:] < rearmost[:-1]) | (driven[1:] > foremost[:-1])])
    order = np.flatnonzero(new)[np.argsort(driven[new])]
    grid = np.arange(driven[order[0]], driven[order[-1]] + STEP_M, STEP_M)
    x, y, yaw = (np.interp(grid, driven[order], values[order]) for values in (*xy.T, heading))
    track = np.stack([x, y], axis=-1)

    spare = 4 * round(_SMOOTH_M / STEP_M)  # samples that smoothing removes at each end
    end = min(round(_END_M / STEP_M), len(grid) - 1)
    behind = _run_out(yaw[0] + np.pi, (yaw[0] - yaw[end]) / _END_M, BEHIND_M + spare * STEP_M)[::-1]
    ahead = _run_out(yaw[-1], (yaw[-1] - yaw[-1 - end]) / _END_M, AHEAD_M + spare * STEP_M)
    path = np.concatenate([track[0] + behind, track, track[-1] + ahead])
    kernel = np.exp(-((np.arange(-spare, spare + 1) * STEP_M / _SMOOTH_M) ** 2) / 2)
    path = np.stack([np.convolve(path[:, axis], kernel / kernel.sum(), "valid") for axis in (0, 1)], axis=-1)

    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    first = len(behind) - spare  # index of the track's first sample in the line
    s_of_grid = length[first : first + len(grid)] - length[first]
    s = np.arange(0.0, length[-1], STEP_M)
    path = np.stack([np.interp(s, length, path[:, axis]) for axis in (0, 1)], axis=-1)
    along = np.gradient(path, axis=0)
    road_heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    route = Route(s - length[first], path, road_heading, np.gradient(road_heading) / STEP_M, lane_m, (), ())
    return route, np.interp(driven, grid, s_of_grid)


def _run_out(heading: float, curvature_1pm: float, length_m: float) -> np.ndarray:
    """Return points [N,2] every STEP_M from the origin, along a bend that fades to a straight."""
    u = (np.arange(round(length_m / STEP_M)) + 0.5) * STEP_M
    bent = np.minimum(u, _FADE_M)
    heading_at = heading + curvature_1pm * (bent - bent**2 / (2 * _FADE_M))
    return np.cumsum(unit(heading_at) * STEP_M, axis=0)


def _turns(route: Route) -> list[tuple[float, float]]:
    """Return s of start and end of the bends that resemble turns at a junction."""
    side = np.sign(route.curvature_1pm) * (np.abs(route.curvature_1pm) > _BEND_1PM)
    edges = np.flatnonzero(np.diff(side)) + 1
    turns = []
    for start, end in pairwise(edges):
        turned = abs(route.heading_rad[end] - route.heading_rad[start])
        if _TURN_RAD[0] < turned < _TURN_RAD[1] and (end - start) * STEP_M < _TURN_M:
            turns.append((float(route.s_m[start]), float(route.s_m[end])))
    return turns


def _is_free(arm: Arm, route: Route) -> bool:
    """Return whether neither the arm nor the barrier across its mouth obstructs the route."""
    out = unit(arm.heading_rad)
    edge = route.lane_m + 0.25
    along, across = np.meshgrid(edge + np.linspace(*BARRIER_M, 4), np.linspace(-arm.half_m, arm.half_m, 9))
    barrier = arm.xy + along[..., None] * out + across[..., None] * [-out[1], out[0]]
    to_route = np.linalg.norm(barrier.reshape(-1, 1, 2) - route.xy, axis=-1)
    return arm_is_clear(arm, route.xy) and bool(to_route.min() > _BESIDE_M + 1.0)
