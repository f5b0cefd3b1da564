"""The pinhole camera forward and back, and what cropping and resizing do to it and to its
images.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import DamagedFile
from pipeline.camera import classes
from pipeline.camera.camera import BELOW_HORIZON, Camera, scan_depth
from pipeline.camera.geometry import back_project, depth_image, project, rays
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.camera.images import nearest, read_pixels, resized
from tests import street

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
    np.testing.assert_allclose(
        (project(xyz, scaled.K)[0] + 0.5) / new_size[::-1], (old + 0.5) / SIZE[::-1], atol=1e-9
    )
    assert (scaled.horizon + 0.5) / height == pytest.approx(17.5 / SIZE[0])
    crop = camera.crop_to(new_size)
    cropped = camera.cropped(crop)
    np.testing.assert_allclose(
        project(xyz, cropped.K)[0], old - [crop.columns.start, crop.rows.start], atol=1e-9
    )
    assert cropped.horizon == 17.0 - crop.rows.start
    assert cropped.size == crop.pixels(np.zeros(SIZE)).shape
    assert crop.size[0] / crop.size[1] == pytest.approx(
        height / width, rel=0.04 + 1 / min(crop.size)
    )


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
    # rounding to uint8
    assert np.abs(resized(ramps(np.uint8), SMALL)[..., :2] - expected).max() <= 0.5
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


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot():
    _, truth, cls = street.scene(0)
    depth = ground_plane_depth(cls, street.CAMERA)
    ground = cls == classes.ROAD
    np.testing.assert_allclose(back_project(depth, street.K)[ground][:, 1], 1.65)
    np.testing.assert_allclose(depth[ground], truth[ground])
    # The street's walls are upright, so each wall pixel is as far as the first road pixel below it,
    # or nearer.
    for column in range(0, street.SIZE[1], 7):
        foot = np.flatnonzero(ground[:, column])[:1]
        if foot.size:
            np.testing.assert_allclose(depth[: foot[0], column], depth[foot[0], column])


def test_hidden_points_are_dropped_and_ground_stays():
    camera = Camera(
        np.array([[360.0, 0, 160], [0, 360, 40], [0, 0, 1]]), (100, 320), T_cam_velo=np.eye(4)
    )
    rows = np.arange(100)[:, None]
    ground = np.where(rows > 45, 1.65 * 360 / np.maximum(rows - 40, 1), 0) * np.ones((1, 320))
    ground[:, 1::3] = 0
    wall = ground.copy()
    wall[20:80:2, 100:140:2] = 6.0  # a car, and street points behind it between its own
    kept, ground_kept = (
        scan_depth(back_project(depth, camera.K)[depth > 0], camera) for depth in (wall, ground)
    )
    np.testing.assert_allclose(ground_kept, ground, rtol=1e-6)
    np.testing.assert_allclose(kept[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(wall, bool)
    hidden[46:79, 100:139] = wall[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not kept[hidden].any()
    np.testing.assert_array_equal(kept[:, :98], ground_kept[:, :98])
