"""Lay out and render one drive of the sample in KITTI raw's layout."""

import hashlib
from pathlib import Path

import cv2
import numpy as np

from pipeline.camera.images import to_units, write_png
from pipeline.sample.inertial import record_oxts
from pipeline.sample.journey import draw_journey
from pipeline.sample.light import draw_ground_colours, draw_light
from pipeline.sample.plan import QUARTERS, draw_character, draw_plan
from pipeline.sample.rig import ImageSensor, Scanner, make_rig
from pipeline.sample.route import DECK
from pipeline.sample.scenery import build_street
from pipeline.sample.settings import Sample
from pipeline.sample.traffic import draw_traffic
from pipeline.sample.world import World

# Options of PNG files. With level 1 and a fixed filter, files are written in half the time and read
# in two thirds of the time. A frame of about 130 kB takes 13 kB more.
_FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_UNFILTERED = (*_FAST, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
_FILTERED = (*_FAST, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP)


def render_drive(
    path: Path, drive: str, settings: Sample, *, frames: int, lidar: bool, truth: bool
) -> dict[str, float]:
    """Render `frames` frames of the drive named `drive` into the new folder `path`.

    The name, such as 2026_01_01_drive_0001, and the seed determine road, street, light and motion.
    Oxts files continue for some frames after the last image, for labels of the path ahead. With
    `lidar`, scans are added. With `truth`, the depth and the classes of the images are added:
    truth/depth (16-bit PNG, metres x 256, 0 for none) and truth/cls (trainIds).

    Returns the number of frames, and the metres driven.
    """
    rng = random_of(drive, settings.seed)
    date = drive[:10]

    # Lay out the street, and let the ego and other cars drive through it.
    quarter, first = choose_theme(drive)
    character = draw_character(rng, quarter)
    journey = draw_journey(rng, frames, character, first)
    plan = draw_plan(journey.route, rng, character)
    street = build_street(journey.route, plan, character, rng)
    world = World(plan, street, draw_ground_colours(rng))
    light = draw_light(rng)
    traffic = draw_traffic(journey, rng)

    # Write what the inertial system records.
    packets, timestamps = record_oxts(journey, date, rng)
    oxts = _make_folder(path / "oxts", timestamps)
    for number, packet in enumerate(packets):
        (oxts / f"{number:010d}.txt").write_bytes(packet)

    # Render what camera and scanner record in each frame.
    rig = make_rig(settings.image_size, date)
    camera = ImageSensor(rig)
    images = _make_folder(path / "image_02", timestamps)
    if lidar:
        scanner = Scanner(rig, settings.scan_rays)
        scans = _make_folder(path / "velodyne_points", timestamps)
    if truth:
        depths = path / "truth" / "depth"
        depths.mkdir(parents=True)
        classes = path / "truth" / "cls"
        classes.mkdir()
    for number in range(frames):
        world.set_traffic([car.mesh_at(number) for car in traffic if car.visible[number]])
        pose = journey.pose_at(number)
        rgb, depth_m, cls = camera.take_image(world, light, pose)
        png = f"{number:010d}.png"
        write_png(images / png, rgb, *_UNFILTERED)
        if truth:
            write_png(depths / png, to_units(depth_m), *_FILTERED)
            write_png(classes / png, cls, *_UNFILTERED)
        if lidar:
            scan = scanner.take_scan(world, pose, random_of(drive, settings.seed, number))
            (scans / f"{number:010d}.bin").write_bytes(scan.tobytes())

    s_m = journey.motion.s_m
    return {"frames": frames, "metres": round(float(s_m[-1] - s_m[0]), 1)}


def _make_folder(sensor: Path, timestamps: bytes) -> Path:
    """Return the new folder for the files of a sensor, beside its timestamps."""
    data = sensor / "data"
    data.mkdir(parents=True)
    (sensor / "timestamps.txt").write_bytes(timestamps)
    return data


def choose_theme(drive: str) -> tuple[str, str]:
    """Return the quarter and the first manoeuvre of a drive.

    Both depend on number and date, so that a few short drives cover all of them.
    """
    day = int(drive[8:10])
    number = int(drive[-4:])
    quarters = [*QUARTERS]
    # Different factors of the day pair each quarter with all manoeuvres.
    return quarters[(number - 2 * day) % len(quarters)], DECK[(number - day) % len(DECK)]


def random_of(drive: str, seed: int, *frame: int) -> np.random.Generator:
    """Return the random generator of a drive with `seed`, or of a frame of that drive."""
    digest = hashlib.sha256(f"{seed}/{drive}".encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "big"), *frame])
