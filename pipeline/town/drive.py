"""One drive of the town, from its name to files in KITTI raw's layout."""

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.town import light as lights
from pipeline.town import motion as motions
from pipeline.town.layout import DriveFolder
from pipeline.town.plan import draw_plan
from pipeline.town.rig import make_rig
from pipeline.town.route import AHEAD_M, draw_route
from pipeline.town.sensors import Camera, Scanner, imu_pose
from pipeline.town.street import build_street, draw_character
from pipeline.town.traffic import draw_traffic
from pipeline.town.world import World

_CRUISE_MPS = (7.0, 10.0)
TRAFFIC_M = 100.0  # farther cars are not drawn


def write_drive(
    drive: str, path: Path, *, frames: int, size: tuple[int, int], scan_rays: tuple[int, int], seed: int
) -> dict[str, Any]:
    """Render `frames` frames of the drive named `drive` (2026_01_01_drive_0001) into the folder `path`.

    Args:
        size: [H, W] of the pictures.
        scan_rays: rings and rays per ring of the scanner.
        seed: of the whole town; together with the name it determines road, street, light and motion.

    Returns: what a log may say: frames, metres driven, mean squared steering angle (wheelbase 2.7 m).

    The folder appears under its name only when complete. Calibration files belong to the date's folder, see
    :func:`pipeline.town.rig.write_calibration`.
    """
    rng = np.random.default_rng(_seed(seed, drive))
    times = motions.frame_times(rng, frames)
    cruise = rng.uniform(*_CRUISE_MPS)
    route = draw_route(rng, cruise * times[-1] + AHEAD_M)
    stops = motions.draw_stops(rng, route, 0.75 * cruise * times[-1])
    motion = motions.drive(route, motions.speed_profile(route, cruise, stops), times, rng.uniform(1.5, 3.0))
    character = draw_character(rng)
    plan = draw_plan(route, rng, character.pavement_m, character.bays)
    world = World(plan, build_street(route, plan, character, rng), lights.draw_ground_colours(rng))
    light = lights.draw_light(rng)
    traffic = draw_traffic(route, motion, rng)
    rows = motions.oxts_rows(route, motion, *rng.uniform((48.9, 8.3), (49.1, 8.5)))

    unfinished = path.with_name(path.name + ".tmp")
    shutil.rmtree(unfinished, ignore_errors=True)
    folder = DriveFolder(unfinished)
    folder.put_timestamps(drive[:10], rng.uniform(8, 17) * 3600 + times)
    rig = make_rig(size)
    camera, scanner = Camera(rig), Scanner(rig, scan_rays)
    xy, heading = route.at(motion.s_m)
    for frame in range(frames):
        near = [vehicle for vehicle in traffic if np.linalg.norm(vehicle.xy[frame] - xy[frame]) < TRAFFIC_M]
        world.set_traffic([vehicle.at(frame) for vehicle in near])
        pose = imu_pose(xy[frame], heading[frame])
        noise = np.random.default_rng([_seed(seed, drive), frame])
        folder.put(frame, *camera.take(world, light, pose), scanner.take(world, pose, noise), rows[frame])
    shutil.rmtree(path, ignore_errors=True)
    unfinished.rename(path)
    steering = np.arctan(2.7 * route.curvature(motion.s_m))
    return {
        "frames": frames,
        "metres": round(float(motion.s_m[-1]), 1),
        "mean_steering_squared_rad2": round(float(np.mean(steering**2)), 5),
    }


def _seed(seed: int, drive: str) -> int:
    return int.from_bytes(hashlib.sha256(f"{seed}/{drive}".encode()).digest()[:8], "big")
