"""The page of steer view: points by class and edges in 3D."""

import numpy as np

from pipeline.camera.classes import ROAD, VOID
from pipeline.report.street_view import View
from steer import space


def test_points_have_a_trace_per_class_and_edges_one_in_each_frame():
    xyz = np.array([[1.0, 2, 3], [4, 3, 6], [7, 1, 9], [7, 1, 51]])  # the last is outside
    edges = np.array([[1, 2], [2, 3]])
    cls = np.array([ROAD, ROAD, VOID, VOID])
    views = [View(7, xyz=xyz, points_cls=cls, edges=edges, edge_count=3)]
    views += [View(9, xyz=xyz[:1], points_cls=np.array([ROAD]), edges=edges[:0])]
    figure = space.plot_frames(views, "a drive")
    road, void, line = figure.data
    assert (road.name, road.marker.color, void.name) == ("road", "rgb(128, 64, 128)", "no class")
    assert {*zip(road.x, road.y, road.z, strict=True)} == {(1, 3, -2), (4, 6, -3)}
    np.testing.assert_array_equal(
        [line.x, line.y, line.z], [[4, 7, np.nan], [6, 9, np.nan], [-3, -1, np.nan]]
    )
    first, second = figure.frames
    assert [len(trace.x) for trace in first.data] == [2, 1, 3]
    assert [len(trace.x) for trace in second.data] == [1, 0, 0]
    subtitle = first.layout.title.subtitle.text
    assert subtitle.endswith(": 3 of 4 points, 50% of 3 directed edges")
