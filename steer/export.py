"""Write the points of a frame as a file of other programs: PLY or PCD."""

import errno
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.outputs import check_free
from pipeline.base.store import DriveReader, replacing
from pipeline.camera.camera import find_visible, read_camera
from pipeline.camera.geometry import pixels_of, transform
from pipeline.report import street_view
from steer.artefact import open_drive

# Suffixes of the formats that are written.
SUFFIXES = (".ply", ".pcd")


class Points(NamedTuple):
    """The points of a frame, with the attributes that are exported."""

    xyz: np.ndarray  # float32 [P,3] in metres
    # Name of an attribute in Open3D → its values [P,n].
    attributes: dict[str, np.ndarray]
    # Text for users: the coordinates and the attributes.
    about: str
    camera_xyz: np.ndarray  # [P,3] in metres, camera frame
    # Whether the points are pixels of the frame's image. Otherwise, some may be hidden by others.
    is_of_image: bool


def export_points(path: Path, number: int, out: Path) -> str:
    """Write the points of a frame to `out`, a new PLY or PCD file, and return what it holds.

    `path` is a drive's file of clouds or graphs, whose points have a class, or of stage ingest,
    whose scans have a reflectance. If the frame's image is in the same data folder, points have the
    colour of their pixel, or are black if the camera does not see them. Raises InputError if `out`
    exists or has another suffix, or if the frame has no points.
    """
    if out.suffix not in SUFFIXES:
        raise InputError("expected the name of a PLY or PCD file (.ply, .pcd)", out)
    check_free(out)

    with open_drive(path) as file:
        row = file.row_of(number)
        if "xyz" in file:
            points = _read_cloud(file, row)
            images = _open_images(file)
        elif "T_cam_velo" in file:
            points = _read_scan(file, row)
            images = file
        else:
            fix = "Pass a file of point clouds, of graphs of points, or of scans"
            raise InputError("has no points", path, fix)
        if not len(points.xyz):
            raise InputError(f"frame {number} has no points", path)

        rgb = None
        if images is not None:
            rgb = _pick_colours(points, number, images)
        about = f"{len(points.xyz):,} points in metres, {points.about}"
        if rgb is None:
            about += ", no colour, as there is no image in data/ingest"
        else:
            points.attributes["colors"] = rgb
            about += ", colour (black: not seen by the camera)"
        _write_points(points, out)
    return about


def _read_cloud(file: DriveReader, row: int) -> Points:
    """Read the points of a cloud or graph, and their classes."""
    xyz = file.rows_of("xyz", row)
    cls = file.rows_of("cls", row)
    about = "camera coordinates (x right, y down, z forward), class (Cityscapes trainId)"

    # A file of clouds has its kind in the name of its folder, without which no image is found.
    variant = file.params.get("graphs", {})
    source = variant.get("source", f"clouds/{file.path.parent.resolve().name}")
    return Points(xyz, {"class": cls[:, None]}, about, xyz, is_of_image=source == "clouds/pseudo")


def _read_scan(file: DriveReader, row: int) -> Points:
    """Read the points of a scan, and their reflectance."""
    scan = file.rows_of("lidar", row)
    xyz = scan[:, :3]
    about = "velodyne coordinates (x forward, y left, z up), intensity (reflectance, 0 to 1)"
    camera_xyz = transform(file["T_cam_velo"], xyz)
    return Points(xyz, {"intensity": scan[:, 3:]}, about, camera_xyz, is_of_image=False)


def _open_images(file: DriveReader) -> DriveReader | None:
    """Open the drive's file of stage ingest in the same data folder; None if it is not there.

    `file` is in data/clouds/KIND or data/graphs/VARIANT. Both files are closed together.
    """
    # The folder is resolved without the file, which DVC may have linked to its cache.
    data = file.path.parent.resolve().parent.parent
    ingest = data / "ingest" / file.path.name
    if not ingest.is_file():
        return None
    return file.enter_context(DriveReader(ingest, stage="ingest"))


def _pick_colours(points: Points, number: int, ingest: DriveReader) -> np.ndarray | None:
    """Return the colours, uint8 [P,3], of points in the frame's image.

    Points outside of the image, or hidden by others, are black. Returns None if the frame has no
    image.
    """
    image = street_view.read_view(number, ingest).rgb
    if image is None:
        return None
    camera = read_camera(ingest)
    if points.is_of_image:
        index, row, column = pixels_of(points.camera_xyz, camera.K, camera.size)
    else:
        index, row, column = find_visible(points.camera_xyz, camera)
    rgb = np.zeros((len(points.xyz), 3), np.uint8)
    rgb[index] = image[row, column]
    return rgb


def _write_points(points: Points, out: Path) -> None:
    """Write points in the format of the suffix of `out`. Raises OSError if the disk is full."""
    import open3d as o3d

    cloud = o3d.t.geometry.PointCloud()
    for name, values in {"positions": points.xyz, **points.attributes}.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(values))

    # If the disk is full, Open3D may report success for an incomplete PLY file.
    size = points.xyz.nbytes + sum(values.nbytes for values in points.attributes.values())
    with replacing(out) as unfinished:
        is_written = o3d.t.io.write_point_cloud(unfinished, cloud)
        if not is_written or unfinished.stat().st_size < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(out))
