"""Test the pinhole camera forward and back, and cropped and resized with its images."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera import classes
from pipeline.camera.camera import BELOW_HORIZON, Camera, scan_depth
from pipeline.camera.geometry import back_project, camera_rays, depth_image, project
from pipeline.camera.ground_plane import ground_plane_depth
from pipeline.camera.images import read_classes, read_pixels, resize_image, resize_nearest
from pipeline.camera.pinhole import MAX_DEPTH_M, WIDE, depth_limit
from tests import street

K = np.array([[70.0, 0, 31.4], [0, 72.0, 20.7], [0, 0, 1]])
SIZE = (40, 64)
SMALL = (20, 16)
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
    uv, _ = project(np.array([[0.0, 0, 5], [0, 0, 0], [1, 1, -5]]), K)
    np.testing.assert_allclose(uv[0], K[:2, 2])
    assert np.isnan(uv[1:]).all()

    ray = camera_rays(K, SIZE)[7, 9]
    outside = camera_rays(K, SIZE)[7, -1] + [1 / K[0, 0], 0, 0]
    depth = depth_image(np.array([30 * ray, 4 * ray, 9 * ray, -2 * ray, 5 * outside]), K, SIZE)
    assert depth[7, 9] == 4
    assert np.count_nonzero(depth) == 1


@given(sides, sides, seeds)
def test_scaled_and_cropped_cameras_project_to_the_moved_position(height, width, seed):
    """A pixel covers [u - 1/2, u + 1/2], so edges scale and centres do not."""
    camera = Camera(K, SIZE, horizon=17.0)
    new_size = (height, width)
    xyz = np.random.default_rng(seed).uniform([-3, -2, 5], [3, 2, 20], (100, 3))
    uv, _ = project(xyz, K)

    scaled = camera.scaled(new_size)
    scaled_uv, _ = project(xyz, scaled.K)
    share = (scaled_uv + 0.5) / new_size[::-1]
    np.testing.assert_allclose(share, (uv + 0.5) / SIZE[::-1], atol=1e-9)
    assert (scaled.horizon + 0.5) / height == pytest.approx(17.5 / SIZE[0])

    crop = camera.crop_to(new_size)
    cropped = camera.cropped(crop)
    cropped_uv, _ = project(xyz, cropped.K)
    corner = [crop.columns.start, crop.rows.start]
    np.testing.assert_allclose(cropped_uv, uv - corner, atol=1e-9)
    assert cropped.horizon == 17.0 - crop.rows.start
    assert cropped.size == crop.cut_out(np.zeros(SIZE)).shape
    aspect = crop.size[0] / crop.size[1]
    assert aspect == pytest.approx(height / width, rel=0.04 + 1 / min(crop.size))

    mirrored_uv, _ = project(xyz * [-1, 1, 1], camera.mirrored().K)
    np.testing.assert_allclose(mirrored_uv, [SIZE[1] - 1, 0] + uv * [-1, 1], atol=1e-9)


def test_depth_reaches_farther_through_a_long_lens():
    limits_m = []
    for factor in (0.5, 1.0, 3.0):
        K = np.diag([factor * WIDE * SIZE[1], 50.0, 1.0])
        limits_m.append(depth_limit(Camera(K, SIZE)))
    assert limits_m == pytest.approx([MAX_DEPTH_M, MAX_DEPTH_M, 3 * MAX_DEPTH_M])


@pytest.mark.parametrize("horizon", [None, 12.0, 30.0, 500.0])
def test_crops_lie_around_the_horizon_or_the_principal_point(horizon):
    crop = Camera(K, SIZE, horizon=horizon).crop_to((16, 64))
    middle = (crop.rows.start + crop.rows.stop - 1) / 2
    expected = K[1, 2] if horizon is None else horizon + BELOW_HORIZON * 64
    assert crop.columns == slice(0, 64)
    assert crop.size == (16, 64)
    assert middle == pytest.approx(min(expected, SIZE[0] - 8.5), abs=0.5)


def test_pixels_move_with_the_intrinsics():
    """Images whose pixels hold their own coordinates show from where resizing took them."""
    back = np.linalg.inv(Camera(np.eye(3), SIZE).scaled(SMALL).K)
    v, u = np.mgrid[: SMALL[0], : SMALL[1]]
    expected = (np.stack([u, v, np.ones_like(u)], axis=-1) @ back.T)[..., :2]

    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    image = np.stack([u, v, 0 * u], axis=-1).astype(np.uint8)
    origin = resize_image(image, SMALL)[..., :2]
    # Half a pixel is reached, so that the last bit of the expected position must not count.
    half = 0.5 + 1e-9
    assert np.abs(origin - expected).max() <= half  # rounding to uint8

    picked = resize_nearest((1000 * v + u).astype(np.uint16), SMALL)
    origin = np.stack([picked % 1000, picked // 1000], axis=-1)
    assert np.abs(origin - expected).max() <= half  # an even factor has no central pixel
    assert picked.dtype == np.uint16


NOISE = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)


def png(pixels: np.ndarray) -> bytes:
    """Return the content of a PNG file."""
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"GIF89a", "not a PNG or JPEG"),
        (b"\xff\xd8\xff\xd9", "decoded"),
        (png(NOISE)[:-20], "decoded"),
    ],
)
def test_plainly_wrong_images(tmp_path, content, problem):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(DamagedFile, match=problem):
        read_pixels(tmp_path / "a")


def palette_png(numbers: np.ndarray) -> bytes:
    """Return the content of a PNG file of numbers [H,W], each with a colour."""
    height, width = numbers.shape
    rows = b"".join(b"\0" + row.tobytes() for row in numbers)
    content = b"\x89PNG\r\n\x1a\n"
    for kind, data in (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
        (b"PLTE", NOISE.tobytes()[:768]),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ):
        checksum = struct.pack(">I", zlib.crc32(kind + data))
        content += struct.pack(">I", len(data)) + kind + data + checksum
    return content


@pytest.mark.parametrize("content", [palette_png(NOISE[..., 0] % 19), png(NOISE)])
def test_class_numbers_have_one_channel(tmp_path, content):
    """The colours of a palette are not its numbers."""
    (tmp_path / "a.png").write_bytes(content)
    assert read_pixels(tmp_path / "a.png").shape == NOISE.shape
    with pytest.raises(InputError, match=r"a\.png: is in colour: save it as one channel"):
        read_classes(tmp_path / "a.png")


def test_ground_is_a_plane_and_objects_have_the_depth_of_their_foot():
    _, truth, cls = street.scene(0)
    depth = ground_plane_depth(cls, street.CAMERA)
    ground = cls == classes.ROAD
    np.testing.assert_allclose(back_project(depth, street.K)[ground][:, 1], 1.65)
    np.testing.assert_allclose(depth[ground], truth[ground])
    # The street's walls are upright, so each wall pixel is as far as the first road pixel below it,
    # or nearer.
    for column in range(0, street.SIZE[1], 7):
        if ground[:, column].any():
            foot = np.argmax(ground[:, column])
            np.testing.assert_allclose(depth[:foot, column], depth[foot, column])


def test_hidden_points_are_dropped_and_ground_stays():
    f = 360.0
    horizon = 40
    K = np.array([[f, 0, 160], [0, f, horizon], [0, 0, 1]])
    camera = Camera(K, (100, 320), T_cam_velo=np.eye(4))

    # Two thirds of the ground's pixels have a point.
    rows = np.arange(100)[:, None]
    plane = np.where(rows > 45, 1.65 * f / np.maximum(rows - horizon, 1), 0)
    ground = plane * np.ones((1, 320))
    ground[:, 1::3] = 0
    # A car has points in a quarter of its pixels; between them are points of the street behind it.
    with_car = ground.copy()
    with_car[20:80:2, 100:140:2] = 6.0

    visible_ground = scan_depth(back_project(ground, K)[ground > 0], camera)
    np.testing.assert_allclose(visible_ground, ground, rtol=1e-6)

    visible = scan_depth(back_project(with_car, K)[with_car > 0], camera)
    np.testing.assert_allclose(visible[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(with_car, bool)
    hidden[46:79, 100:139] = with_car[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not visible[hidden].any()
    np.testing.assert_array_equal(visible[:, :98], visible_ground[:, :98])
