"""Lay out and render one drive of the sample in KITTI raw's layout."""

import hashlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.base.errors import named_frames
from pipeline.camera.images import to_units, write_png
from pipeline.sample.light import draw_ground_colours, draw_light
from pipeline.sample.manoeuvres import DECK
from pipeline.sample.motion import draw_journey
from pipeline.sample.oxts import record
from pipeline.sample.plan import QUARTERS, draw_character, draw_plan
from pipeline.sample.rig import make_rig
from pipeline.sample.sensors import ImageSensor, Scanner
from pipeline.sample.street import build_street
from pipeline.sample.traffic import draw_traffic
from pipeline.sample.world import World

SENSORS = ("image_02", "velodyne_points", "oxts")
# Level 1 and one filter per file: half the time of writing and two thirds of reading for 13 kB more of a frame's 130.
_LEVEL = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER)
WHEELBASE_M = 2.7  # for the steering angles in the log; labels have their own in params.yaml


class Drive:
    """One drive of the sample: road, street, light, traffic and motion."""

    def __init__(
        self, drive: str, *, frames: int, size: tuple[int, int], scan_rays: tuple[int, int], seed: int
    ) -> None:
        """Lay out the drive named `drive` (2026_01_01_drive_0001) with `frames` frames.

        Args:
            size: [H, W] of the pictures.
            scan_rays: rings and rays per ring of the scanner.
            seed: of the sample; with the name it determines road, street, light and motion.
        """
        self._name, self._seed = drive, seed
        rng = random_of(drive, seed)
        quarter, first = theme(drive)
        character = draw_character(rng, quarter)
        self._journey = draw_journey(rng, frames, character, first)
        route = self._journey.route
        plan = draw_plan(route, rng, character)
        self._world = World(plan, build_street(route, plan, character, rng), draw_ground_colours(rng))
        self._light = draw_light(rng)
        self._traffic = draw_traffic(self._journey, rng)
        self._packets, self._timestamps = record(self._journey, drive[:10], rng)
        rig = make_rig(size, drive[:10])
        self._camera, self._scanner = ImageSensor(rig), Scanner(rig, scan_rays)

    def write(self, path: Path) -> None:
        """Render all frames into the folder `path`, with their oxts files and timestamps.txt of all sensors.

        Oxts files continue for some frames after the last image, for labels of the path ahead.
        Ground truth lies beside them: truth/depth (16-bit PNG, metres x 256, 0: none) and truth/cls (trainIds).
        """
        images, scans, packets = (path / sensor / "data" for sensor in SENSORS)
        depths, classes = path / "truth" / "depth", path / "truth" / "cls"
        for folder in (images, scans, packets, depths, classes):
            folder.mkdir(parents=True)
        for sensor in SENSORS:
            (path / sensor / "timestamps.txt").write_bytes(self._timestamps)
        for number, packet in enumerate(self._packets):
            (packets / f"{number:010d}.txt").write_bytes(packet)
        for number in named_frames(range(len(self._journey.motion.time_s))):
            self._world.set_traffic([vehicle.at(number) for vehicle in self._traffic if vehicle.visible[number]])
            pose, png = self._journey.pose(number), f"{number:010d}.png"
            rgb, depth_m, cls = self._camera.take(self._world, self._light, pose)
            write_png(images / png, rgb, *_LEVEL, cv2.IMWRITE_PNG_FILTER_NONE)
            write_png(depths / png, to_units(depth_m), *_LEVEL, cv2.IMWRITE_PNG_FILTER_UP)
            write_png(classes / png, cls, *_LEVEL, cv2.IMWRITE_PNG_FILTER_NONE)
            scan = self._scanner.take(self._world, pose, random_of(self._name, self._seed, number))
            (scans / f"{number:010d}.bin").write_bytes(scan.tobytes())

    def summary(self) -> dict[str, Any]:
        """Return the number of frames, metres driven and mean squared steering angle of the road (WHEELBASE_M)."""
        motion = self._journey.motion
        steering = np.arctan(WHEELBASE_M * self._journey.route.curvature(motion.s_m))
        return {
            "frames": len(motion.time_s),
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
    """Return the random generator of a drive of the sample with `seed`, or of one of its frames."""
    digest = hashlib.sha256(f"{seed}/{drive}".encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "big"), *frame])
