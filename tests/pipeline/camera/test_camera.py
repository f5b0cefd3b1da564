"""The pinhole camera forward and back, and what cropping and resizing do to it and to its images."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import DamagedFile
from pipeline.camera.camera import BELOW_HORIZON, Camera
from pipeline.camera.geometry import back_project, depth_image, project, rays
from pipeline.camera.images import nearest, read_pixels, resized

K = np.array([[70.0, 0, 31.4], [0, 72.0, 20.7], [0, 0, 1]])
SIZE, SMALL = (40, 64), (20, 16)
seeds = st.integers(0, 2**32 - 1)
sides = st.integers(16, 400)


@given(seeds)
def test_project_and_depth_image_undo_back_project(seed):
    depth = np.random.default_rng(seed).uniform(1, 80, SIZE)
    xyz = back_project(depth, K).reshape(-1, 3)
    uv, z = project(xyz, K)
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    np.testing.assert_allclose(uv, np.stack([u, v], axis=-1).reshape(-1, 2), atol=1e-9)
    np.testing.assert_allclose(z, depth.ravel())
    np.testing.assert_allclose(depth_image(xyz, K, SIZE), depth)


def test_points_behind_have_no_pixel_and_the_nearest_counts():
    uv, z = project(np.array([[0.0, 0, 5], [0, 0, 0], [1, 1, -5]]), K)
    np.testing.assert_allclose(uv[0], K[:2, 2])
    assert np.isnan(uv[1:]).all()
    np.testing.assert_array_equal(z, [5, 0, -5])
    ray, outside = rays(K, SIZE)[7, 9], rays(K, SIZE)[7, -1] + [1 / K[0, 0], 0, 0]
    depth = depth_image(np.array([30 * ray, 4 * ray, 9 * ray, -2 * ray, 5 * outside]), K, SIZE)
    assert (depth[7, 9], np.count_nonzero(depth)) == (4, 1)


@given(sides, sides, seeds)
def test_scaled_and_cropped_cameras_project_to_the_moved_position(height, width, seed):
    """A pixel covers [u - 1/2, u + 1/2], so edges scale and centres do not."""
    camera, new_size = Camera(K, SIZE, horizon=17.0), (height, width)
    xyz = np.random.default_rng(seed).uniform([-3, -2, 5], [3, 2, 20], (100, 3))
    old, scaled = project(xyz, K)[0], camera.scaled(new_size)
    np.testing.assert_allclose((project(xyz, scaled.K)[0] + 0.5) / new_size[::-1], (old + 0.5) / SIZE[::-1], atol=1e-9)
    assert (scaled.horizon + 0.5) / height == pytest.approx(17.5 / SIZE[0])
    crop = camera.crop_to(new_size)
    cropped = camera.cropped(crop)
    np.testing.assert_allclose(project(xyz, cropped.K)[0], old - [crop.columns.start, crop.rows.start], atol=1e-9)
    assert cropped.horizon == 17.0 - crop.rows.start
    assert cropped.size == crop.pixels(np.zeros(SIZE)).shape
    assert crop.size[0] / crop.size[1] == pytest.approx(height / width, rel=0.04 + 1 / min(crop.size))


@pytest.mark.parametrize("horizon", [None, 12.0, 30.0, 500.0])
def test_crops_lie_around_the_horizon_or_the_principal_point(horizon):
    crop = Camera(K, SIZE, horizon=horizon).crop_to((16, 64))
    middle = (crop.rows.start + crop.rows.stop - 1) / 2
    expected = K[1, 2] if horizon is None else horizon + BELOW_HORIZON * 64
    assert (crop.columns, crop.size) == (slice(0, 64), (16, 64))
    assert middle == pytest.approx(min(expected, SIZE[0] - 8.5), abs=0.5)


def ramps(dtype: type) -> np.ndarray:
    """Return [H,W,3] whose pixels hold their own coordinates (u, v, 0)."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.stack([u, v, 0 * u], axis=-1).astype(dtype)


def test_pixels_move_with_the_intrinsics():
    back = np.linalg.inv(Camera(np.eye(3), SIZE).scaled(SMALL).K)
    v, u = np.mgrid[: SMALL[0], : SMALL[1]]
    expected = (np.stack([u, v, np.ones_like(u)], axis=-1) @ back.T)[..., :2]
    assert np.abs(resized(ramps(np.uint8), SMALL)[..., :2] - expected).max() <= 0.5  # rounding to uint8
    u, v = ramps(np.uint16)[..., 0], ramps(np.uint16)[..., 1]
    picked = nearest(1000 * v + u, SMALL)
    where = np.stack([picked % 1000, picked // 1000], axis=-1)
    assert np.abs(where - expected).max() <= 0.5  # an even factor has no central pixel
    assert picked.dtype == np.uint16


NOISE = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"GIF89a", "not a PNG or JPEG"),
        (b"\xff\xd8\xff\xd9", "decoded"),
        (cv2.imencode(".png", NOISE)[1].tobytes()[:-20], "decoded"),
        (cv2.imencode(".png", np.dstack([NOISE, NOISE])[..., :4])[1].tobytes(), "transparent"),
    ],
)
def test_plainly_wrong_images(tmp_path, content, problem):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(DamagedFile, match=problem):
        read_pixels(tmp_path / "a")
