"""Lay out and render one drive of the sample in KITTI raw's layout."""

import hashlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.camera.images import to_units, write_png
from pipeline.sample.inertial import record
from pipeline.sample.journey import draw_journey
from pipeline.sample.light import draw_ground_colours, draw_light
from pipeline.sample.plan import QUARTERS, draw_character, draw_plan
from pipeline.sample.rig import ImageSensor, Scanner, make_rig
from pipeline.sample.route import DECK
from pipeline.sample.scenery import build_street
from pipeline.sample.settings import Sample
from pipeline.sample.traffic import draw_traffic
from pipeline.sample.world import World

# Level 1 and one filter per file: half the time of writing and two thirds of reading for 13 kB more
# of a frame's 130.
_LEVEL = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER)


def render_drive(
    path: Path, drive: str, settings: Sample, *, frames: int, lidar: bool, truth: bool
) -> dict[str, Any]:
    """Lay out the drive named `drive` (2026_01_01_drive_0001), and render `frames` frames into the
    new folder `path`.

    The name and the seed determine road, street, light and motion. Oxts files continue for some
    frames after the last image, for labels of the path ahead. `lidar`: add scans; `truth`: add
    truth/depth (16-bit PNG, metres x 256, 0: none) and truth/cls (trainIds) of the images.

    Returns the number of frames and metres driven.
    """
    rng = random_of(drive, settings.seed)
    quarter, first = theme(drive)
    character = draw_character(rng, quarter)
    journey = draw_journey(rng, frames, character, first)
    plan = draw_plan(journey.route, rng, character)
    world = World(plan, build_street(journey.route, plan, character, rng), draw_ground_colours(rng))
    light, traffic = draw_light(rng), draw_traffic(journey, rng)
    packets, timestamps = record(journey, drive[:10], rng)
    rig = make_rig(settings.image_size, drive[:10])
    camera, scanner = ImageSensor(rig), Scanner(rig, settings.scan_rays) if lidar else None

    images, oxts, scans = (
        path / sensor / "data" for sensor in ("image_02", "oxts", "velodyne_points")
    )
    depths, classes = path / "truth" / "depth", path / "truth" / "cls"
    for folder in (images, oxts, *[scans] * bool(scanner)):
        folder.mkdir(parents=True)
        (folder.parent / "timestamps.txt").write_bytes(timestamps)
    for folder in (depths, classes) if truth else ():
        folder.mkdir(parents=True)
    for number, packet in enumerate(packets):
        (oxts / f"{number:010d}.txt").write_bytes(packet)
    for number in range(frames):
        world.set_traffic([vehicle.at(number) for vehicle in traffic if vehicle.visible[number]])
        pose, png = journey.pose(number), f"{number:010d}.png"
        rgb, depth_m, cls = camera.take(world, light, pose)
        write_png(images / png, rgb, *_LEVEL, cv2.IMWRITE_PNG_FILTER_NONE)
        if truth:
            write_png(depths / png, to_units(depth_m), *_LEVEL, cv2.IMWRITE_PNG_FILTER_UP)
            write_png(classes / png, cls, *_LEVEL, cv2.IMWRITE_PNG_FILTER_NONE)
        if scanner:
            scan = scanner.take(world, pose, random_of(drive, settings.seed, number))
            (scans / f"{number:010d}.bin").write_bytes(scan.tobytes())

    s_m = journey.motion.s_m
    return {"frames": frames, "metres": round(float(s_m[-1] - s_m[0]), 1)}


def theme(drive: str) -> tuple[str, str]:
    """Return a drive's quarter and first manoeuvre. They vary with number and date: a few short
    drives cover all.
    """
    day, number = int(drive[8:10]), int(drive[-4:])
    return [*QUARTERS][(number - 2 * day) % len(QUARTERS)], DECK[(number - day) % len(DECK)]


def random_of(drive: str, seed: int, *frame: int) -> np.random.Generator:
    """Return the random generator of a drive of the sample with `seed`, or of one of its frames."""
    digest = hashlib.sha256(f"{seed}/{drive}".encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "big"), *frame])
