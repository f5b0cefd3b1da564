import numpy as np

from pipeline.camera import classes
from pipeline.camera.geometry import back_project
from pipeline.perception.ground_plane import ground_plane_depth, limit_traffic_depth
from tests import street


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot() -> None:
    _, truth, cls = street.scene(0)
    depth = ground_plane_depth(cls, street.K, 1.65)
    ground = cls == classes.ROAD
    np.testing.assert_allclose(back_project(depth, street.K)[ground][:, 1], 1.65)
    np.testing.assert_allclose(depth[ground], truth[ground])
    # The street's walls are upright, so each wall pixel is as far as the first road pixel below it, or nearer.
    for column in range(0, street.SIZE[1], 7):
        foot = np.flatnonzero(ground[:, column])[:1]
        if foot.size:
            np.testing.assert_allclose(depth[: foot[0], column], depth[foot[0], column])


def test_only_traffic_is_limited() -> None:
    _, truth, cls = street.scene(0)
    cls = cls.copy()
    column = np.flatnonzero((cls == classes.ROAD).any(axis=0) & (cls == classes.BUILDING).any(axis=0))[0]
    lorry = np.zeros(cls.shape, bool)
    lorry[:, column] = cls[:, column] == classes.BUILDING
    cls[lorry] = classes.TRUCK
    depth = np.where(lorry, 70.0, truth)
    limit_traffic_depth(depth, cls, street.K, 1.65, reach=1.1)
    np.testing.assert_array_equal(depth[~lorry], truth[~lorry])
    np.testing.assert_allclose(depth[lorry], 1.1 * ground_plane_depth(cls, street.K, 1.65)[lorry])
    near = np.where(lorry, 2.0, truth)
    limit_traffic_depth(near, cls, street.K, 1.65, reach=1.1)
    assert (near[lorry] == 2.0).all()
