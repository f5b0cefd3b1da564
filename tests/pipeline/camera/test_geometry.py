"""The pinhole camera: forward and back, and what resizing does to it."""

import numpy as np

from pipeline.camera.camera import Camera
from pipeline.camera.geometry import back_project, depth_image, project, rays

K = np.array([[70.0, 0, 31.4], [0, 72.0, 20.7], [0, 0, 1]])
SIZE = (40, 64)


def pixels() -> np.ndarray:
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def test_project_undoes_back_project() -> None:
    depth = np.random.default_rng(0).uniform(1, 80, SIZE)
    uv, z = project(back_project(depth, K).reshape(-1, 3), K)
    np.testing.assert_allclose(uv, pixels(), atol=1e-10)
    np.testing.assert_allclose(z, depth.ravel())


def test_depth_image_undoes_back_project() -> None:
    depth = np.random.default_rng(0).uniform(1, 80, SIZE)
    np.testing.assert_allclose(depth_image(back_project(depth, K).reshape(-1, 3), K, SIZE), depth)


def test_a_plane_stays_a_plane() -> None:
    """Depth where each ray meets the plane n·X = h, back-projected, lies on the plane."""
    normal, height = np.array([0.02, -0.999, -0.04]), -1.65
    along = rays(K, SIZE) @ normal
    below = along < -1e-3
    depth = np.where(below, height / np.where(below, along, 1), 0)
    assert below.sum() > 1000
    points = back_project(depth, K)[below]
    np.testing.assert_allclose(points @ normal, height, atol=1e-12)
    assert points[:, 2].max() > 10, "the plane reaches far"


def test_points_behind_have_no_pixel() -> None:
    uv, z = project(np.array([[0.0, 0, 5], [0, 0, 0], [1, 1, -5]]), K)
    np.testing.assert_allclose(uv[0], K[:2, 2])
    assert np.isnan(uv[1:]).all()
    np.testing.assert_array_equal(z, [5, 0, -5])


def test_scaled_camera_projects_to_the_scaled_position() -> None:
    """A pixel covers [u - 1/2, u + 1/2], so edges scale and centres do not."""
    camera, new_size = Camera(K, SIZE), (20, 16)
    xyz = np.random.default_rng(0).uniform([-3, -2, 5], [3, 2, 20], (100, 3))
    old, new = project(xyz, K)[0], project(xyz, camera.scaled(new_size).K)[0]
    np.testing.assert_allclose((new + 0.5) / new_size[::-1], (old + 0.5) / SIZE[::-1])
    np.testing.assert_allclose(camera.scaled(new_size).scaled(SIZE).K, K)
    np.testing.assert_array_equal(camera.scaled(SIZE).K, K)


def test_depth_image_keeps_the_nearest_point() -> None:
    ray = rays(K, SIZE)[7, 9]
    outside = rays(K, SIZE)[7, -1] + [1 / K[0, 0], 0, 0]
    depth = depth_image(np.array([30 * ray, 4 * ray, 9 * ray, -2 * ray, 5 * outside]), K, SIZE)
    assert depth[7, 9] == 4
    assert np.count_nonzero(depth) == 1
