"""Lay out and render one drive of the town in KITTI raw's layout."""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import progress
from pipeline.kitti.raw import RawDrive
from pipeline.town.character import QUARTERS, draw_character
from pipeline.town.journey import draw_journey, record
from pipeline.town.layout import DriveFolder
from pipeline.town.light import draw_ground_colours, draw_light
from pipeline.town.manoeuvres import DECK
from pipeline.town.oxts import read_recording
from pipeline.town.plan import draw_plan
from pipeline.town.replay import replay
from pipeline.town.rig import make_rig
from pipeline.town.sensors import Camera, Scanner
from pipeline.town.street import build_street
from pipeline.town.traffic import draw_traffic, visible
from pipeline.town.world import World

WHEELBASE_M = 2.7  # for the steering angles in the log; labels have their own in params.yaml


class Drive:
    """One drive of the town: road, street, light, traffic and motion."""

    def __init__(
        self,
        drive: str,
        *,
        frames: int,
        size: tuple[int, int],
        scan_rays: tuple[int, int],
        seed: int,
        recorded: RawDrive | None = None,
    ) -> None:
        """Lay out the drive named `drive` (2026_01_01_drive_0001) with `frames` frames.

        Args:
            size: [H, W] of the pictures.
            scan_rays: rings and rays per ring of the scanner.
            seed: of the town; with the name it determines road, street, light and motion.
            recorded: a real drive to replay: its first `frames` frames along a road laid under its track; its oxts
                files are copied.
        """
        self._name, self._seed = drive, seed
        rng = random_of(drive, seed)
        recording = read_recording(recorded, frames) if recorded else None
        quarter, first = theme(drive)
        character = draw_character(rng, quarter)
        if recording:
            self._journey = replay(drive, recording, rng, character.lane_m)
        else:
            self._journey = draw_journey(rng, frames, character, first)
        route, motion = self._journey.route, self._journey.motion
        plan = draw_plan(route, rng, character)
        self._world = World(plan, build_street(route, plan, character, rng), draw_ground_colours(rng))
        self._light = draw_light(rng)
        traffic = draw_traffic(route, motion, rng)
        self._traffic = [(vehicle, visible(vehicle, self._journey)) for vehicle in traffic]
        self._recording = recording or record(self._journey, drive[:10], rng)
        rig = make_rig(size, drive[:10])
        self._camera, self._scanner = Camera(rig), Scanner(rig, scan_rays)

    def write(self, path: Path) -> None:
        """Render all frames into the folder `path`, with their oxts files."""
        folder = DriveFolder(path)
        folder.put_recording(self._recording)
        for i, number in enumerate(progress.track(self._recording.packets)):
            self._world.set_traffic([vehicle.at(i) for vehicle, visible_at in self._traffic if visible_at[i]])
            pose = self._journey.pose(i)
            noise = random_of(self._name, self._seed, number)
            picture = self._camera.take(self._world, self._light, pose)
            folder.put(number, *picture, self._scanner.take(self._world, pose, noise))

    def summary(self) -> dict[str, Any]:
        """Return the number of frames, metres driven and mean squared steering angle of the road (WHEELBASE_M)."""
        motion = self._journey.motion
        steering = np.arctan(WHEELBASE_M * self._journey.route.curvature(motion.s_m))
        return {
            "frames": len(self._recording.packets),
            "metres": round(float(motion.s_m[-1] - motion.s_m[0]), 1),
            "mean_steering_squared_rad2": round(float(np.mean(steering**2)), 5),
        }


def theme(drive: str) -> tuple[str, str]:
    """Return the quarter that a drive crosses and the manoeuvre it begins with.

    They vary with number and date, so that a few short drives cover all.
    """
    day, number = int(drive[8:10]), int(drive[-4:])
    return QUARTERS[(number - 2 * day) % len(QUARTERS)], DECK[(number - day) % len(DECK)]


def random_of(drive: str, seed: int, *frame: int) -> np.random.Generator:
    """Return the random generator of a drive of the town with `seed`, or of one of its frames."""
    digest = hashlib.sha256(f"{seed}/{drive}".encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "big"), *frame])
