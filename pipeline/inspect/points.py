"""A frame's points as a PLY file, and in Open3D's viewer."""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.graphs.cloud import Cloud

_NO_POINTS = "{title}: there are no points. Clouds, graphs, ingest and raw drives with scans have some"


def write_ply(path: Path, title: str, cloud: Cloud | None) -> int:
    """Write points [P,3] (camera frame, m) with the colour and, as ``label``, the trainId of each; return how many.

    Raises InputError if there are none, or the file's name is not that of a PLY.
    """
    if path.suffix.lower() != ".ply":
        raise InputError(f"{path} is no name of a PLY file: --ply NAME.ply")
    made = _open3d(title, cloud)
    import open3d

    with replacing(path) as unfinished:
        if not open3d.t.io.write_point_cloud(unfinished, made):
            raise OSError(f"Open3D could not write {path}")
    return len(made.point.positions)


def view(title: str, cloud: Cloud | None) -> None:
    """Show points in Open3D's viewer until it is closed. Raises InputError where there is no display, or no points."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("there is no display here for --view (DISPLAY is not set): write a file with --ply NAME.ply")
    made = _open3d(title, cloud)
    import open3d

    # Behind the camera and above it, looking ahead: its y points down.
    open3d.visualization.draw_geometries(
        [made.to_legacy()], window_name=title, front=[0, -0.4, -1], lookat=[0, 0, 15], up=[0, -1, 0], zoom=0.2
    )


def _open3d(title: str, cloud: Cloud | None) -> Any:
    if cloud is None or not len(cloud[0]):
        raise InputError(_NO_POINTS.format(title=title))
    import open3d

    xyz, cls = cloud
    parts = {"positions": xyz.astype(np.float32), "colors": classes.colourise(cls), "label": cls[:, None]}
    tensors = {name: open3d.core.Tensor.from_numpy(np.ascontiguousarray(part)) for name, part in parts.items()}
    return open3d.t.geometry.PointCloud(tensors)
