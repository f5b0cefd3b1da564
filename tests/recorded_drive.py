"""Write recorded drives with known motion: oxts files in KITTI raw's layout, for tests of the replay."""

from pathlib import Path

import numpy as np

from pipeline.kitti.oxts import make_rows
from pipeline.kitti.raw import RawDrive
from pipeline.sample.oxts import make_recording

DRIVE = "2011_09_26_drive_0007"
DT_S = 0.1


def drive_along(
    speed_mps: np.ndarray, curvature_1pm: np.ndarray, heading_rad: float = 0.7
) -> tuple[np.ndarray, np.ndarray]:
    """Return oxts rows [F,30] and the exact track [F,2] of a car with such speeds and curvatures [F] at its frames."""
    fine = 50
    time = np.arange(len(speed_mps)) * DT_S
    steps = np.arange((len(time) - 1) * fine) * DT_S / fine + DT_S / fine / 2
    v, kappa = np.interp(steps, time, speed_mps), np.interp(steps, time, curvature_1pm)
    turned = v * kappa * DT_S / fine
    heading = heading_rad + np.cumsum(turned) - turned / 2
    moved = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * (v * DT_S / fine)[:, None]
    track = np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)[fine - 1 :: fine]])
    yaw = heading_rad + np.concatenate([[0.0], np.cumsum(turned)[fine - 1 :: fine]])
    rows = make_rows(
        len(time),
        lat=49.0,
        lon=8.4,
        yaw=np.arctan2(np.sin(yaw), np.cos(yaw)),
        vf=speed_mps,
        wu=speed_mps * curvature_1pm,
        af=np.gradient(speed_mps, DT_S),
        navstat=4,
        numsats=9,
    )
    return rows, track


def curvature_at(s_m: np.ndarray, bends: list[tuple[float, float, float]]) -> np.ndarray:
    """Return the curvature [F] at s_m of a road with `bends` (start, end, curvature) that set in over 6 m."""
    total = np.zeros(len(s_m))
    for start, end, curvature in bends:
        total += np.interp(s_m, [start, start + 6, end - 6, end], [0, curvature, curvature, 0])
    return total


def sample_trip() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left and right turn, and a halt between them, from which the car first rolls back 4 m: rows, track, driven."""
    speeds = [6.0, 6, 0, 0, -2, -2, 0, 0, 7, 7]
    speed = np.interp(np.arange(220), [0, 60, 75, 95, 105, 115, 125, 130, 150, 219], speeds)
    driven = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * DT_S)])
    rows, track = drive_along(speed, curvature_at(driven, [(10, 34, 0.085), (55, 83, -0.07)]))
    return rows, track, driven


def round_the_block() -> tuple[np.ndarray, np.ndarray]:
    """Four left turns, and on along the street that the drive began in, crossing it at its end: rows, track."""
    driven = np.arange(0, 360, 0.8)
    # A quarter turn: 2 x 6 m of transition and the arc between them turn by (length - 6) x curvature.
    quarter = [(start, start + 22, np.pi / 2 / 16) for start in np.arange(4) * 70 + 40.0]
    return drive_along(np.full(len(driven), 8.0), curvature_at(driven, [*quarter, (325, 350, -np.pi / 2 / 19)]))


def write_recorded(root: Path, rows: np.ndarray, frames: range | None = None, drive: str = DRIVE) -> RawDrive:
    """Write the packets under the numbers `frames` (default: from 0); timestamps.txt has a line for each number."""
    numbers = frames or range(len(rows))
    recording = make_recording(rows, np.arange(numbers[-1] + 1) * DT_S, drive[:10], start_s=40_000.0)
    folder = root / drive[:10] / f"{drive}_sync" / "oxts"
    (folder / "data").mkdir(parents=True)
    for number, packet in zip(numbers, recording.packets.values(), strict=True):
        (folder / "data" / f"{number:010d}.txt").write_bytes(packet)
    (folder / "timestamps.txt").write_bytes(recording.timestamps)
    return RawDrive(folder.parent)
