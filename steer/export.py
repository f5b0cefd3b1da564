"""Write the points of a frame as a file of other programs: PLY or PCD."""

import errno
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipeline.jobs.outputs import check_free

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, replacing
from pipeline.camera.camera import find_visible
from pipeline.camera.geometry import pixels_of
from pipeline.ingest.stored_camera import read_camera
from pipeline.report import street_view
from steer.artefact import open_drive, open_images

# Suffixes of the formats that are written.
SUFFIXES = (".ply", ".pcd")


def export_points(path: Path, number: int, out: Path) -> str:
    """Write the points of a frame to `out`, a new PLY or PCD file, and return what it holds.

    `path` is a drive's file of clouds or graphs. If the frame's image is in the same data folder,
    points have the colour of their pixel, or are black if the camera does not see them. Raises
    InputError if `out` exists or has another suffix, or if the frame has no points.
    """
    if out.suffix not in SUFFIXES:
        raise InputError("expected the name of a PLY or PCD file (.ply, .pcd)", out)
    check_free(out)

    with open_drive(path) as file:
        if "xyz" not in file:
            fix = "Pass a file of point clouds, or of graphs of points"
            raise InputError("has no points", path, fix)
        row = file.row_of(number)
        xyz = file.rows_of("xyz", row)
        if not len(xyz):
            raise InputError(f"frame {number} has no points", path)

        rgb = _pick_colours(file, number, xyz)
        about = f"{len(xyz):,} points in metres, camera coordinates (x right, y down, z forward), "
        about += "class (Cityscapes trainId)"
        # Name of an attribute in Open3D → its values [P,n].
        attributes = {"positions": xyz, "class": file.rows_of("cls", row)[:, None]}
        for name in file.signs:
            about += f", {name}"
            attributes |= _name_attributes(name, file.rows_of(name, row))
        if rgb is None:
            about += ", no colour, as there is no image in data/ingest"
        else:
            attributes["colors"] = rgb
            about += ", colour (black: not seen by the camera)"
        _write_points(attributes, out)
    return about


def _pick_colours(file: DriveReader, number: int, xyz: np.ndarray) -> np.ndarray | None:
    """Return the colours, uint8 [P,3], of the points of a frame in its image.

    Points outside of the image, or hidden by others, are black. Returns None if there is no image.
    """
    ingest = open_images(file)
    if ingest is None:
        return None
    image = street_view.read_view(number, ingest).rgb
    if image is None:
        return None
    camera = read_camera(ingest)

    # A file of clouds has its kind in the name of its folder, without which no image is found.
    variant = file.params.get("graphs", {})
    source = variant.get("source", f"clouds/{file.path.parent.resolve().name}")
    # Points of an image are its pixels, so none hides another.
    if source == "clouds/pseudo":
        index, row, column = pixels_of(xyz, camera.K, camera.size)
    else:
        index, row, column = find_visible(xyz, camera)
    rgb = np.zeros((len(xyz), 3), np.uint8)
    rgb[index] = image[row, column]
    return rgb


def _name_attributes(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the attributes of a column [P,C] in a file: its components, but normals as they are.

    Both formats know normals. Of other attributes, a PCD file has only those with one component.
    """
    components = values.shape[1]
    if components == 1 or (name == "normals" and components == 3):
        return {name: values}
    return {f"{name}_{number}": values[:, [number]] for number in range(components)}


def _write_points(attributes: Mapping[str, np.ndarray], out: Path) -> None:
    """Write points in the format of the suffix of `out`. Raises OSError if the disk is full."""
    import open3d as o3d

    cloud = o3d.t.geometry.PointCloud()
    for name, values in attributes.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(values))

    # If the disk is full, Open3D may report success for an incomplete PLY file.
    size = sum(values.nbytes for values in attributes.values())
    with replacing(out) as unfinished:
        is_written = o3d.t.io.write_point_cloud(unfinished, cloud)
        if not is_written or unfinished.stat().st_size < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(out))
