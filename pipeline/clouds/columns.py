"""Further columns of clouds: what a point has beside its position and class.

A source of clouds names its columns here, in SOURCES. `clouds.columns` of params.yaml chooses some
of them. docs/models.md has an example.
"""

import re
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from pipeline.base.errors import InputError, closest, error_context
from pipeline.base.store import Column
from pipeline.camera.camera import Camera, Frame

# Dataset of clouds and of graphs with the first point of each frame.
POINTER = "ptr"
# Names that datasets of clouds and graphs have already.
_DATASETS = (
    "frame",
    "time_s",
    "xyz",
    "cls",
    "image",
    "degree",
    "indices",
    "edges_knn",
    "edges_kept",
)
# Names of further arrays of a batch, see pipeline/train/windows.py.
_ARRAYS = ("windows", "dt_s", "base", "motion", "target", "prepared")
# Names of attributes of points in exported files, see steer/export.py.
_ATTRIBUTES = ("positions", "class", "colors")
# Endings of names of datasets and arrays that belong to another one.
_ENDINGS = ("ptr", "_signs")
# First words of units that are lengths, in small letters. Only the unit "m" itself is scaled with
# the points, so any other length would silently stay as it is.
_LENGTHS = (
    *("m", "dm", "cm", "mm", "km"),
    *("metre", "metres", "meter", "meters"),
    *("centimetre", "centimetres", "centimeter", "centimeters"),
    *("millimetre", "millimetres", "millimeter", "millimeters"),
)


class Points(NamedTuple):
    """All points of a frame, before some are drawn, and what they were made from."""

    xyz: np.ndarray  # float32 [P,3] in metres in the camera frame
    cls: np.ndarray  # trainIds uint8 [P]
    frame: Frame  # image, depth_m and cls of pseudo clouds; scan [P,4] and cls of LiDAR clouds
    camera: Camera
    pixels: np.ndarray | None  # bool [H,W]: the pixels of the points, row by row; None of a scan


class FurtherColumn(NamedTuple):
    """C numbers for each point."""

    # Function that returns them, finite and of shape [P,C]. It is not called without points.
    compute: Callable[[Points], np.ndarray]
    # Factors of the C numbers in the mirror image: -1 for a component to the right, otherwise 1.
    signs: tuple[int, ...]
    # Unit of the numbers. What is in "m" is scaled together with the points (train.rescale), and
    # no other unit of length is accepted.
    unit: str
    # Type in the file. uint8, which the function returns itself, has only signs of 1, and is not in
    # metres.
    type: Literal["float32", "uint8"] = "float32"
    # What the numbers mean, for readers of the files.
    meaning: str = ""

    def with_rows(self, rows: np.ndarray) -> Column:
        """Return the column with these rows [P,C]."""
        return Column(rows.astype(self.type), self.unit, POINTER, self.signs, self.meaning)

    def empty(self) -> Column:
        """Return the column without rows."""
        return self.with_rows(np.empty((0, len(self.signs))))


def intensity(points: Points) -> np.ndarray:
    """Return the reflectance of the points of a scan, [P,1] from 0 to 1."""
    return points.frame.scan[:, 3:]


# Source of clouds → its further columns by name.
SOURCES: dict[str, dict[str, FurtherColumn]] = {
    "pseudo": {},
    "lidar": {
        "intensity": FurtherColumn(
            intensity,
            signs=(1,),
            unit="reflectance, 0 to 1",
            meaning="reflectance of the surface, as the scanner measured it",
        )
    },
}


def check_column(name: str) -> None:
    """Raise InputError if no source has a further column of this name, or if it is no valid one."""
    declared = [columns[name] for columns in SOURCES.values() if name in columns]
    if not declared:
        known = sorted({name for columns in SOURCES.values() for name in columns})
        raise InputError(f"unknown column {name!r}: {closest(name, known)}")
    is_taken = name in (*_DATASETS, *_ARRAYS, *_ATTRIBUTES) or name.endswith(_ENDINGS)
    if is_taken or not name.isidentifier():
        raise InputError(f"a column cannot have the name {name!r}", fix="Choose another one")
    for further in declared:
        if not further.signs or {*further.signs} - {1, -1}:
            problem = f"signs = {further.signs}, expected a 1 or -1 for each number of a point"
            raise InputError(problem, f"column {name!r}")
        if further.type == "uint8" and (further.unit == "m" or -1 in further.signs):
            problem = "uint8 cannot change its sign, and cannot be scaled"
            raise InputError(problem, f"column {name!r}", "Use float32")
        first_word = re.split(r"[\s,;:(]", further.unit.strip().lower())[0]
        if first_word in _LENGTHS and further.unit != "m":
            problem = f"unit = {further.unit!r} is a length that is not scaled with the points"
            fix = "Compute metres, with unit = 'm', and describe them in meaning"
            raise InputError(problem, f"column {name!r}", fix)


def compute_columns(source: str, names: Sequence[str], points: Points) -> dict[str, Column]:
    """Compute further columns of a frame's points. Raises InputError for an unsuitable array."""
    columns = {}
    for name in names:
        columns[name] = SOURCES[source][name].empty()
        if len(points.xyz):
            with error_context(f"column {name!r}, frame {points.frame.number}"):
                columns[name] = _compute_column(SOURCES[source][name], points)
    return columns


def _compute_column(further: FurtherColumn, points: Points) -> Column:
    """Compute a column, and check its shape, its type, and that it is finite."""
    rows = np.asarray(further.compute(points))
    shape = (len(points.xyz), len(further.signs))
    if rows.shape != shape:
        raise InputError(
            f"got the shape {rows.shape}, expected {shape}",
            fix="Return a row for each point, and a number for each sign",
        )
    if further.type == "uint8" and rows.dtype != np.uint8:
        raise InputError(f"got {rows.dtype}, expected uint8", fix="Convert it, or use float32")
    column = further.with_rows(rows)
    if not np.isfinite(column.rows).all():
        raise InputError("got NaN or infinity", fix="Return finite numbers")
    return column
