"""Make semantic point clouds (paper eq. 6 and 7) from images or scans, and choose their points.

A point is in metres and has the class of its pixel. Clouds are in the rectified camera frame: x
right, y down, z forward. Clouds always have classes. How much they count, the factor λ of eq. 7, is
a setting of each model (`semantics`). Further columns are those of columns.py.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.store import Column, DriveReader, DriveWriter
from pipeline.base.summary import Summary
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, Frame, find_visible
from pipeline.clouds.cloud_file import UNITS, create_clouds
from pipeline.clouds.columns import POINTER, SOURCES, Points, compute_columns
from pipeline.perception.drive_frames import DriveFrames

if TYPE_CHECKING:
    from pipeline.clouds.settings import Clouds

# Resolution in metres of stored coordinates. It is far finer than that of any sensor, and multiples
# of it are exact in float32 up to 16 km.
RESOLUTION_M = 1 / 1024


@dataclass(frozen=True)
class Cloud:
    """A point cloud: columns with a row for each of P points, by name.

    `xyz`, float32 [P,3] in metres, and `cls`, trainIds uint8 [P], are the first two of them.
    """

    columns: Mapping[str, Column]

    @classmethod
    def from_arrays(
        cls, xyz: np.ndarray, labels: np.ndarray, further: Mapping[str, Column] | None = None
    ) -> "Cloud":
        """Return points `xyz` [P,3] with the trainIds `labels` [P], and further columns."""
        columns = {
            "xyz": Column(xyz, UNITS["xyz"], POINTER),
            "cls": Column(labels, UNITS["cls"], POINTER),
        }
        return cls(columns | dict(further or {}))

    @classmethod
    def read(cls, file: DriveReader, names: Sequence[str], rows: slice) -> "Cloud":
        """Read points of a file of clouds, with its further columns `names`.

        Raises InputError if the file lacks one of them.
        """
        further = {}
        for name in names:
            if name not in file.signs:
                problem = f"has no column {name!r} (it has {', '.join(file.signs) or 'none'})"
                fix = "Add it to clouds.columns, and make the clouds again: dvc repro clouds"
                raise InputError(problem, file.path, fix)
            further[name] = Column(
                file.row(name, rows),
                file.units.get(name, ""),
                POINTER,
                file.signs[name],
                file.meanings.get(name, ""),
            )
        return cls.from_arrays(file.row("xyz", rows), file.row("cls", rows), further)

    @property
    def xyz(self) -> np.ndarray:
        return self.columns["xyz"].rows

    @property
    def cls(self) -> np.ndarray:
        return self.columns["cls"].rows

    def __len__(self) -> int:
        return len(self.xyz)

    def at(self, rows: np.ndarray) -> "Cloud":
        """Return the points in some `rows`."""
        columns = self.columns.items()
        return Cloud({name: column._replace(rows=column.rows[rows]) for name, column in columns})

    def crop(self, crop_m: Sequence[float] | None) -> "Cloud":
        """Return the points inside of a crop, or all for None.

        `crop_m` holds the limits left, near, right and far, of which left and right are limits of
        x, near and far limits of z.
        """
        if crop_m is None:
            return self
        lowest = np.array(crop_m[:2])
        highest = np.array(crop_m[2:])
        xz = self.xyz[:, [0, 2]]
        inside = (lowest <= xz) & (xz <= highest)
        return self.at(np.flatnonzero(inside.all(axis=1)))

    def draw(self, limit: int, rng: np.random.Generator) -> "Cloud":
        """Return at most `limit` random points, in the cloud's order."""
        return self.at(draw_rows(len(self), limit, rng))

    def in_morton_order(self) -> "Cloud":
        """Return the points in Morton order, with xyz rounded to multiples of RESOLUTION_M.

        In this order, neighbours in space are neighbours in memory, so kNN and sparse products are
        faster, and files compress better.
        """
        # A Morton code interleaves the bits of three numbers, here of 21 bits each.
        cells = np.rint(self.xyz / RESOLUTION_M)
        numbers = np.clip(cells + 2**20, 0, 2**21 - 1).astype(np.uint64)
        x, y, z = numbers.T
        code = (
            _spread_bits(x) | (_spread_bits(y) << np.uint64(1)) | (_spread_bits(z) << np.uint64(2))
        )

        rounded = self.columns["xyz"]._replace(rows=(cells * RESOLUTION_M).astype(np.float32))
        cloud = Cloud({**self.columns, "xyz": rounded})
        return cloud.at(np.argsort(code, kind="stable"))

    def append_to(self, file: DriveWriter) -> None:
        """Append the points to the datasets of a file, which the first call creates."""
        for name, column in self.columns.items():
            file.append(name, *column)


def pseudo_cloud(depth_m: np.ndarray, cls: np.ndarray, K: np.ndarray, pixels: np.ndarray) -> Cloud:
    """Back-project the `pixels` of an image that become points, bool [H,W] (paper eq. 6).

    `depth_m` [H,W] is in metres, `cls` [H,W] holds trainIds, and `K` [3,3] the intrinsics.
    """
    xyz = geometry.back_project(depth_m, K)[pixels]
    return Cloud.from_arrays(xyz.astype(np.float32), cls[pixels].astype(np.uint8))


def solid_pixels(depth_m: np.ndarray, cls: np.ndarray, max_depth_m: float) -> np.ndarray:
    """Return which pixels become points, bool [H,W], from depth in metres and trainIds [H,W].

    Pixels without a depth (0), beyond `max_depth_m`, on the sky or without a class (void) do not
    become points. An encoder without classes gives only void. With such an encoder, all pixels up
    to `max_depth_m` become points.
    """
    pixels = (depth_m > 0) & (depth_m <= max_depth_m) & (cls != classes.SKY)
    has_class = cls != classes.VOID
    if has_class.any():
        pixels &= has_class
    return pixels


def lidar_cloud(scan: np.ndarray, camera: Camera, cls: np.ndarray | None) -> Cloud:
    """Transform a scan into the camera frame, and give each point the class of its pixel.

    `scan` [P,≥3] holds x, y, z in metres in the velodyne frame. `cls` [H,W] holds the trainIds of
    the frame's image, or is None. Points that are outside of the image, hidden from the camera, or
    on the sky are void.
    """
    assert camera.T_cam_velo is not None, "the camera belongs to a scanner"
    xyz = geometry.transform(camera.T_cam_velo, scan[:, :3].astype(np.float64))
    labels = np.full(len(xyz), classes.VOID, np.uint8)
    if cls is not None:
        index, row, column = find_visible(xyz, camera)
        labels[index] = cls[row, column]
        # The sky returns no laser pulse, so a point with this class is on the edge of an object.
        labels[labels == classes.SKY] = classes.VOID
    return Cloud.from_arrays(xyz.astype(np.float32), labels)


def frame_cloud(source: str, frame: Frame, camera: Camera, settings: "Clouds") -> Cloud:
    """Return all points of a frame, with the columns that `settings` choose.

    `source` is pseudo (from images) or lidar (from scans).
    """
    pixels = None
    if source == "lidar":
        cloud = lidar_cloud(frame.scan, camera, frame.cls)
    else:
        pixels = solid_pixels(frame.depth_m, frame.cls, settings.max_depth_m)
        cloud = pseudo_cloud(frame.depth_m, frame.cls, camera.K, pixels)
    points = Points(cloud.xyz, cloud.cls, frame, camera, pixels)
    further = compute_columns(source, settings.columns, points)
    return Cloud({**cloud.columns, **further})


def empty_cloud(source: str, names: Sequence[str]) -> Cloud:
    """Return a cloud without points, with the further columns `names` of a source."""
    further = {name: SOURCES[source][name].empty() for name in names}
    return Cloud.from_arrays(np.empty((0, 3), np.float32), np.empty(0, np.uint8), further)


def clouds_drive(
    path: Path, kind: str, ingest: Path, perception: Path, settings: "Clouds"
) -> Summary:
    """Write the clouds of a drive, one per frame, with at most `max_points` random points each.

    `kind` is pseudo (from images) or lidar (from scans), and has the columns of `settings`.
    `ingest` and `perception` are the drive's files of these stages.
    """
    counts = []
    with DriveFrames(ingest, perception, scans=kind == "lidar") as frames:
        params = frames.params | {"clouds": settings.model_dump()}
        with create_clouds(path, drive=frames.drive, params=params) as file:
            file.put("frame", frames.frame)
            file.put("time_s", frames.time_s, UNITS["time_s"])
            # This creates the datasets, also in the file of a drive without frames. Dataset "ptr",
            # which is written at the end, has the rows where frames begin.
            empty_cloud(kind, settings.columns).append_to(file)
            for frame in frames:
                cloud = frame_cloud(kind, frame, frames.camera, settings)
                rng = frame_rng(settings.seed, frames.drive, frame.number)
                drawn = cloud.draw(settings.max_points, rng).in_morton_order()
                drawn.append_to(file)
                counts.append(len(drawn))
            file.put_pointers(POINTER, counts, UNITS[POINTER])
    return {"frames": len(counts), "points": sum(counts)}


def frame_rng(seed: int, drive: str, frame: int) -> np.random.Generator:
    """Return a frame's random generator, which is the same in whatever order frames are made."""
    return np.random.default_rng([seed, zlib.crc32(drive.encode()), frame])


def draw_rows(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `limit` of the rows 0..count-1 without replacement.

    The rows are ascending, which keeps the points in Morton order.
    """
    if count <= limit:
        return np.arange(count)
    return np.sort(rng.choice(count, limit, replace=False, shuffle=False))


def _spread_bits(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits between the 21 low bits of each number."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x
