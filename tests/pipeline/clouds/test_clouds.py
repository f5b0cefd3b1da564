"""Test semantic point clouds, and which of their points are drawn."""

from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import Column
from pipeline.camera import classes, geometry
from pipeline.camera.camera import Camera, Frame
from pipeline.clouds import cloud, columns
from pipeline.clouds.columns import FurtherColumn, Points
from pipeline.clouds.settings import Clouds
from tests import artefacts

# Names that datasets, arrays of batches and attributes of exported files have already.
TAKEN = ["xyz", "degree", "edges_knn", "image", "windows", "motion", "prepared", "colors"]
K = np.array([[100.0, 0, 19.5], [0, 100.0, 9.5], [0, 0, 1]])


def test_pseudo_cloud_has_a_point_per_valid_pixel():
    """Void pixels are points only if no pixel has a class."""
    depth = np.full((20, 40), 10.0)
    cls = np.full((20, 40), classes.ROAD, np.uint8)
    depth[0, 0] = 0.0
    depth[1, 1] = 81.0
    cls[2, 2] = classes.SKY
    cls[3, 3] = classes.VOID
    points = cloud.pseudo_cloud(depth, cls, K, cloud.solid_pixels(depth, cls, max_depth_m=80.0))
    assert (points.cls == classes.ROAD).all()
    uv, z = geometry.project(points.xyz.astype(np.float64), K)
    assert z == pytest.approx(np.full(len(z), 10.0))
    pixels = [*map(tuple, np.rint(uv).astype(int).tolist())]
    no_points = {(0, 0), (1, 1), (2, 2), (3, 3)}
    assert sorted(pixels) == sorted({(u, v) for u in range(40) for v in range(20)} - no_points)

    void = np.full((20, 40), classes.VOID, np.uint8)
    assert cloud.solid_pixels(depth, void, max_depth_m=80.0).sum() == 20 * 40 - 2
    limits = cloud.solid_pixels(np.array([[80.0, 80.1]]), np.zeros((1, 2)), max_depth_m=80.0)
    assert limits.tolist() == [[True, False]]


def test_lidar_points_take_the_class_of_their_pixel():
    T_cam_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    camera = Camera(K, (20, 40), T_cam_velo=T_cam_velo)
    cls = np.full((20, 40), classes.CAR, np.uint8)
    cls[:, 20:] = classes.SKY
    # On a car, inside it, on the street behind it, on the sky, behind the camera, beside the image.
    places = [(10, 1, 0), (12, 1.2, 0), (20, 2, 0), (10, -1, 0), (-10, 0, 0), (10, 50, 0)]
    scan = np.array([(*place, 0.5) for place in places], np.float32)
    points = cloud.lidar_cloud(scan, camera, cls)
    assert points.xyz == pytest.approx(np.array([(-y, -z, x) for x, y, z in places]))
    assert points.cls.tolist() == [classes.CAR] * 2 + [classes.VOID] * 4
    assert (cloud.lidar_cloud(scan, camera, None).cls == classes.VOID).all()


def test_morton_order_equals_bitwise_interleaving():
    xyz = np.random.default_rng(0).uniform(-60, 60, (200, 3))
    row = np.arange(200).astype(np.uint8)  # as class and as a column, so that they show the order
    further = {"row": Column(row[:, None], "", "ptr", (1,))}

    def code(point: np.ndarray) -> int:
        number = 0
        for axis, value in enumerate(point.tolist()):
            cell = round(value * 1024) + 2**20
            for bit in range(21):
                number |= ((cell >> bit) & 1) << (3 * bit + axis)
        return number

    points = cloud.Cloud.from_arrays(xyz, row, further).in_morton_order()
    stored = points.xyz
    order = points.cls
    assert points.columns["row"].rows[:, 0].tolist() == order.tolist()
    np.testing.assert_array_equal(stored, np.rint(xyz[order] * 1024) / 1024)
    codes = [code(point) for point in stored]
    assert codes == sorted(codes)


def test_drawn_points_depend_on_the_frame_alone_lie_in_the_crop_and_keep_order_and_class():
    xyz, cls = artefacts.points(900)

    def drawn(count: int, frame: int) -> list[int]:
        rng = cloud.frame_rng(0, "drive", frame)
        further = {"row": Column(np.arange(900)[:, None], "", "ptr", (1,))}
        points = cloud.Cloud.from_arrays(xyz, cls, further).crop((-5, 0, 5, 20)).draw(count, rng)
        rows = [int(np.flatnonzero((xyz == point).all(axis=1))[0]) for point in points.xyz]
        assert rows == sorted(set(rows))
        assert points.cls.tolist() == cls[rows].tolist()
        assert points.columns["row"].rows[:, 0].tolist() == rows
        return rows

    in_crop = (np.abs(xyz[:, 0]) <= 5) & (xyz[:, 2] >= 0) & (xyz[:, 2] <= 20)
    inside = np.flatnonzero(in_crop).tolist()
    assert drawn(900, 0) == inside
    assert drawn(20, 5) == drawn(20, 5) != drawn(20, 6)
    assert set(drawn(20, 6)) < set(inside)
    assert len(drawn(20, 6)) == 20


def test_settings_without_columns_are_as_before_they_existed():
    """So are params of files, and keys."""
    settings = Clouds(max_points=1, max_depth_m=80, seed=0, columns=[])
    assert settings.model_dump() == {"max_points": 1, "max_depth_m": 80, "seed": 0}
    chosen = settings.model_copy(update={"columns": ("intensity",)})
    assert chosen.of_source("lidar").model_dump(mode="json")["columns"] == ["intensity"]
    assert chosen.of_source("pseudo") == settings


@pytest.mark.parametrize(
    ("values", "kind", "problem"),
    [
        (np.zeros(3), "float32", r"got the shape \(3,\), expected \(3, 2\). Return a row for each"),
        (np.array([[0, np.nan]] * 3), "float32", "got NaN or infinity"),
        (np.full((3, 2), 1e39), "float32", "got NaN or infinity"),
        (np.full((3, 2), 0.5), "uint8", "got float64, expected uint8"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_an_unsuitable_array_of_a_column_is_refused(monkeypatch, values, kind, problem):
    further = FurtherColumn(lambda points: values, signs=(1, 1), unit="", type=kind)
    monkeypatch.setitem(columns.SOURCES["pseudo"], "mine", further)
    xyz = np.zeros((3, 3), np.float32)
    points = Points(xyz, np.zeros(3, np.uint8), Frame(7, 0.7), Camera(K, (20, 40)), None)
    with pytest.raises(InputError, match=f"column 'mine', frame 7: {problem}"):
        columns.compute_columns("pseudo", ["mine"], points)


@pytest.mark.parametrize(
    ("name", "changes", "problem"),
    [
        *((name, {}, f"cannot have the name '{name}'") for name in TAKEN),
        ("my_ptr", {}, "cannot have the name 'my_ptr'"),
        ("my column", {}, "cannot have the name 'my column'"),
        ("mine", {"signs": (0,)}, r"column 'mine': signs = \(0,\), expected"),
        ("mine", {"type": "uint8", "signs": (-1,)}, "column 'mine': uint8 cannot change its sign"),
        ("mine", {"type": "uint8", "unit": "m"}, "column 'mine': .* cannot be scaled"),
        *(
            ("mine", {"unit": unit}, f"column 'mine': unit = '{unit}' is a length.* Compute metres")
            for unit in ("cm", "mm", "km", "Metres", "meters", "m below the camera", "m, downwards")
        ),
    ],
)
def test_a_column_that_cannot_be_stored_is_refused(monkeypatch, name, changes, problem):
    declared: dict[str, Any] = {"signs": (1,), "unit": ""} | changes
    further = FurtherColumn(lambda points: points.xyz, **declared)
    monkeypatch.setitem(columns.SOURCES["lidar"], name, further)
    with pytest.raises(InputError, match=problem):
        columns.check_column(name)


@pytest.mark.parametrize("unit", ["", "m", "m/s", "1/m", "mm/s", "unit vector", "mean grey"])
def test_a_column_in_metres_or_of_another_kind_is_accepted(monkeypatch, unit):
    further = FurtherColumn(lambda points: points.xyz, signs=(1,), unit=unit)
    monkeypatch.setitem(columns.SOURCES["lidar"], "mine", further)
    columns.check_column("mine")
