"""Convert a recording with its logs to drives in KITTI raw's layout: images, packets, angles, manifest, preset."""

import errno
import json
import math
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from tqdm import tqdm

from pipeline.base.errors import InputError, error_context
from pipeline.base.params import SPLITS, check_drive
from pipeline.base.resume import file_hash
from pipeline.base.store import replacing
from pipeline.camera.camera import Camera
from pipeline.camera.images import write_png
from pipeline.kitti.oxts import STEERING, format_packet, format_times, make_rows, write_steering
from pipeline.kitti.raw import CALIBRATION, HORIZON, MANIFEST, read_calibration, write_entries
from pipeline.motion.visual import MAX_DEPTH_M, WIDE
from pipeline.settings.preset import stamped
from pipeline.video.log import ROUNDING_S, Logs
from pipeline.video.source import Source

CAMERA = 2  # left colour camera, the default of stage ingest
_IMAGES = f"image_{CAMERA:02d}"
GAP_S = 2.0  # left out between the parts of a split: neighbouring images are almost the same
_NOON_S = 12 * 3600.0  # time of day of the first image; nothing depends on it
_SAME_PX = 1e-6  # rounding of a calibration file's digits


class Imported(NamedTuple):
    """What was written."""

    images: dict[str, int]  # drive → number of images
    manifests: dict[str, str]  # drive → hash of its manifest
    hz: float  # frame rate of the recording


def import_drives(
    source: Source,
    root: Path,
    drive: str,
    shares: Sequence[float],
    span_s: tuple[float, float] = (0.0, math.inf),
    *,
    replace: bool = False,
) -> Imported:
    """Write a recording as drives below `root`; images without motion, if there is a log of it, are left out.

    `drive` is the name of the first; the others have the following numbers. `shares` of the duration: one for each, see
    :func:`cut`. Images before and after `span_s` since the first one are left out. Raises InputError if a drive exists,
    no image is left or none of a drive has an angle, a part is too short, or the date has another camera.
    """
    camera, logs, drives = source.camera, source.logs, _drive_folders(root, drive, len(shares), replace)
    folders, date = list(drives.values()), root / drive[:10]
    calibrated = _is_calibrated(folders, camera, replace)
    elapsed_s = source.time_s - source.time_s[0]
    time_s = source.time_s[elapsed_s <= span_s[1] - ROUNDING_S]
    usable = elapsed_s[: len(time_s)] > span_s[0] - ROUNDING_S
    source.notes.extend(logs.notes(time_s[usable]))
    if logs.motion:
        usable &= np.isfinite(logs.motion.at(time_s)[0])
    if not usable.any():
        end_s = min(span_s[1], elapsed_s[-1])
        problem = f"no image from {span_s[0]:g} to {end_s:.3f} s after the first is left, or none with motion"
        raise InputError(problem, fix="Change --start, --end or --offset")
    parts = cut(usable, time_s, shares)
    counts = {drive: int(part.sum()) for drive, part in zip(drives, parts, strict=True)}
    with _unfinished(folders, sum(counts.values()) * 3 * math.prod(camera.size)) as unfinished:
        for folder, part in zip(unfinished, parts, strict=True):
            _write_logs(folder, time_s, part, camera, logs)
        for frame in tqdm(islice(source.frames(), len(time_s)), total=len(time_s), unit=" images", disable=None):
            for folder, part in zip(unfinished, parts, strict=True):
                if part[frame.number]:
                    write_png(folder / _IMAGES / "data" / f"{frame.number:010d}.png", frame.image)
        if not calibrated:
            P = np.column_stack([camera.K, np.zeros(3)])
            size = np.array(camera.size[::-1], float)
            entries = {"R_rect_00": np.eye(3), f"S_rect_{CAMERA:02d}": size, f"P_rect_{CAMERA:02d}": P}
            write_entries(date / CALIBRATION, entries)
        for folder in unfinished:
            content = {"calibration": file_hash(date / CALIBRATION), "files": _hashes(folder)}
            (folder / MANIFEST).write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="ascii")
        manifests = [file_hash(folder / MANIFEST) for folder in unfinished]
    hz = (len(time_s) - 1) / float(np.ptp(time_s) or 1.0)
    return Imported(counts, dict(zip(drives, manifests, strict=True)), hz)


@contextmanager
def _unfinished(folders: Sequence[Path], size: int) -> Iterator[list[Path]]:
    """Yield temporary folders that replace `folders`; a failure leaves nothing of them, nor of killed imports.

    Raises InputError on a full disk. `size`: of the images, bytes.
    """
    date = folders[0].parent
    for killed in [path for folder in folders for path in date.glob(f".{folder.name}.*.tmp")]:
        shutil.rmtree(killed)
    try:
        with ExitStack() as stack:
            yield [stack.enter_context(replacing(folder)) for folder in folders]
            for folder in folders:
                shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise InputError(f"disk is full: images need up to {size / 1e6:,.0f} MB", date, "Pass another --out") from error
    finally:
        with suppress(OSError):  # if not empty
            date.rmdir()


def _write_logs(folder: Path, time_s: np.ndarray, usable: np.ndarray, camera: Camera, logs: Logs) -> None:
    """Make a drive's folders, and write horizon, times, packets and angles of its `usable` images [F] at `time_s` [F].

    Packets hold speed and yaw rate; the rest is unknown, 0.
    """
    if camera.horizon is not None:
        write_entries(folder / HORIZON, {f"horizon_{CAMERA:02d}": np.array([round(camera.horizon, 2)])})
    times = format_times(time_s - time_s[0], folder.name[:10], _NOON_S)
    (folder / _IMAGES / "data").mkdir(parents=True)
    (folder / _IMAGES / "timestamps.txt").write_bytes(times)
    numbers = np.flatnonzero(usable)
    if logs.motion:
        (folder / "oxts" / "data").mkdir(parents=True)
        (folder / "oxts" / "timestamps.txt").write_bytes(times)
        speed_mps, yaw_rate_radps = logs.motion.at(time_s[usable])
        for number, row in zip(numbers, make_rows(len(numbers), vf=speed_mps, wu=yaw_rate_radps), strict=True):
            (folder / "oxts" / "data" / f"{number:010d}.txt").write_bytes(format_packet(row))
    if logs.wheel:
        steering_rad = zip(numbers.tolist(), logs.wheel.at(time_s[usable])[0].tolist(), strict=True)
        angles = {number: angle for number, angle in steering_rad if math.isfinite(angle)}
        if not angles:
            raise InputError(f"no image of {folder.name} has an angle", "--wheel", "Check its times")
        write_steering(folder / STEERING, angles)


def cut(usable: np.ndarray, time_s: np.ndarray, shares: Sequence[float]) -> list[np.ndarray]:
    """Cut the `usable` images, bool [F], taken at `time_s` [F], into consecutive parts; return a mask of each.

    GAP_S are left out between two parts. Raises InputError if a part would have fewer than two images.
    """
    first_s, last_s = time_s[usable][[0, -1]]
    edges_s = first_s + (last_s - first_s) * np.cumsum([0.0, *shares]) / sum(shares)
    ends_s = [*(edges_s[1:-1] - GAP_S), math.inf]
    parts = [usable & (time_s >= begin) & (time_s < end) for begin, end in zip(edges_s[:-1], ends_s, strict=True)]
    if short := next((share for share, part in zip(shares, parts, strict=True) if part.sum() < 2), None):
        problem = f"the part of {short:g} % has fewer than 2 images ({last_s - first_s:.1f} s in all)"
        fix = f"Pass a longer recording, or other shares: {GAP_S:g} s are left out between parts"
        raise InputError(problem, "--split", fix)
    return parts


def _drive_folders(out: Path, drive: str, count: int, replace: bool) -> dict[str, Path]:
    """Return name → folder below `out` of `count` drives with consecutive numbers, from `drive` on.

    Raises InputError if one exists, with `replace` only if it is not as an earlier import wrote it.
    """
    folders = {}
    for part in range(count):
        name = f"{drive[:-4]}{int(drive[-4:]) + part:04d}" if part else drive
        with error_context(f"--drive {name}"):
            check_drive(name)
        folder = folders[name] = out / name[:10] / f"{name}_sync"
        if folder.exists() and not replace:
            raise InputError("drive exists", folder, "Replace it with --replace, or pass --drive another number")
        written = json.loads((folder / MANIFEST).read_text())["files"] if (folder / MANIFEST).is_file() else {}
        found = _hashes(folder)
        if others := sorted(name for name in {*written, *found} if written.get(name) != found.get(name)):
            problem = f"{others[0]} is not as steer import wrote it ({len(others)} such files)"
            raise InputError(problem, folder, "Move the folder away, or pass --drive another number")
    return folders


def _hashes(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if not path.is_dir() and path.name != MANIFEST]
    return {path.relative_to(folder).as_posix(): file_hash(path) for path in files}


def _is_calibrated(folders: Sequence[Path], camera: Camera, replace: bool) -> bool:
    """Return whether the date folder of the drives at `folders` already has this calibration.

    Raises InputError if it has the calibration of another camera; with `replace`, only if other drives share it.
    """
    date = folders[0].parent
    stored = read_calibration(date, CAMERA) if (date / CALIBRATION).is_file() else None
    if stored and stored.size == camera.size and np.allclose(stored.K, camera.K, rtol=0, atol=_SAME_PX):
        return True
    if not stored or (replace and all(drive in folders for drive in date.glob("*_sync"))):
        return False
    fix = "Pass --drive another date: all drives of a date share the calibration"
    raise InputError("date has the calibration of another camera", date, fix)


def write_preset(path: Path, imported: Imported, source: str, camera: Camera, height_m: float | None = None) -> None:
    """Write a preset with two models, with and without measured motion as input.

    Motion that is the label (`source`) cannot be an input for the same frame, so visual labels are predicted a second
    ahead. A wheel's angle and measured motion may differ in scale: no base. Depth grows with focal length / width, and
    so does its limit.
    """
    network = {"input": "depth", "spatial": "gnn", "temporal": "ncp", "semantics": 0.0, "equivariant": True}
    if source == "visual":
        network["horizon"] = max(1, round(imported.hz))
    settings: dict[str, Any] = {
        "ingest": {
            "source": "kitti",
            "image_size": [192, 640],  # the depth network's training size
            "lidar": False,
            "drives": {split: [drive] for split, drive in zip(SPLITS, imported.manifests, strict=True)},
            "manifests": imported.manifests,
        },
        "encoder": {"backbone": "street", "weights": "weights/street/encoder.pt", "epochs": 0},
        "perception": {"camera_height_m": height_m} if height_m else {},
        "labels": {"source": source},
        "clouds": {"max_depth_m": float(round(MAX_DEPTH_M * max(1.0, camera.K[0, 0] / camera.size[1] / WIDE)))},
        "graphs": {"*": None, "depth": {"source": "clouds/pseudo", "points": 1000, "k": 6}},
        "models": {
            "*": None,
            "motion": network | {"motion": "visual"} | ({"base": "none"} if source == "wheel" else {}),
            "scene": network,
        },
        # A single recording is small. Recorded angles do not scale with the scene.
        "train": {"epochs": 40} | ({"rescale": 1.0} if source == "wheel" else {}),
    }
    text = f"# Train on this recording and test on its end: make street, then make {path.stem}\n"
    text += yaml.safe_dump(settings, sort_keys=False)
    with replacing(path) as unfinished:
        unfinished.write_text(stamped(text, "steer import"), encoding="utf-8")
