"""The page of steer view: points by class and edges in 3D."""

import numpy as np

from pipeline.camera.classes import ROAD, VOID
from pipeline.report.street_view import View
from steer import space


def test_points_have_a_trace_per_class_and_edges_one():
    xyz = np.array([[1.0, 2, 3], [4, 3, 6], [7, 1, 9], [7, 1, 51]])  # the last is outside
    edges = np.array([[1, 2], [2, 3]])
    cls = np.array([ROAD, ROAD, VOID, VOID])
    view = View(7, xyz=xyz, points_cls=cls, edges=edges)
    road, void, line = space.plot_frame(view).data
    assert (road.name, road.marker.color, void.name) == ("road", "rgb(128, 64, 128)", "no class")
    assert {*zip(road.x, road.y, road.z, strict=True)} == {(1, 3, -2), (4, 6, -3)}
    assert (*void.x, *void.y, *void.z) == (7, 9, -1)
    np.testing.assert_array_equal(
        [line.x, line.y, line.z], [[4, 7, np.nan], [6, 9, np.nan], [-3, -1, np.nan]]
    )
