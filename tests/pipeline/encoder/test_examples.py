from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.geometry import rays
from pipeline.camera.png import read_png
from pipeline.encoder.examples import Example, Supervision, mirrored, read_truth, relit, spread, teaching_rows, visible
from pipeline.kitti.raw import RawDrive
from tests import street

DRIVE = "2026_01_01_drive_0001"


def test_dense_truth_is_read_as_metres_and_classes(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 2, dense=True, lidar=True)
    _, depth, cls = street.scene(1)
    with store.DriveReader(tmp_path / f"{DRIVE}.h5", stage="ingest") as file:
        truth = read_truth(file, 1)
    assert truth.depth_source == "dense"
    np.testing.assert_allclose(truth.depth_m, depth, atol=0.5 / 256 + 1e-6)
    np.testing.assert_array_equal(truth.cls, cls)


def test_lidar_truth_is_known_only_where_a_point_fell_and_classes_are_void(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 2, dense=False, lidar=True)
    _, depth, _ = street.scene(1)
    with store.DriveReader(tmp_path / f"{DRIVE}.h5", stage="ingest") as file:
        truth = read_truth(file, 1)
    hit = np.zeros(street.SIZE, bool)
    hit[::2, ::4] = depth[::2, ::4] > 0
    np.testing.assert_array_equal(truth.depth_m > 0, hit)
    np.testing.assert_allclose(truth.depth_m[hit], depth[hit], rtol=1e-4)
    assert truth.depth_source == "lidar"
    assert not truth.has_cls
    assert (truth.cls == classes.VOID).all()


def test_rows_without_image_or_without_truth_teach_nothing(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 3, dense=False, lidar=False)
    street.write_drive(tmp_path, "2026_01_01_drive_0002", 3, images=False)
    for name in (DRIVE, "2026_01_01_drive_0002"):
        with store.DriveReader(tmp_path / f"{name}.h5", stage="ingest") as file:
            assert len(teaching_rows(file)) == 0
    with pytest.raises(InputError, match=r"no frame of the training drives .* has an image together with"):
        Supervision(tmp_path, [DRIVE, "2026_01_01_drive_0002"], 10)


@pytest.mark.parametrize(("count", "wanted"), [(10, 3), (10, 10), (10, 99), (1000, 7), (20573, 20000)])
def test_spread_is_even_and_without_repeats(count: int, wanted: int) -> None:
    rows = spread(count, wanted)
    assert len(rows) == min(count, wanted)
    steps = np.diff(rows)
    assert steps.min() >= 1
    assert steps.max() - steps.min() <= 1


def test_frames_are_spread_over_drives_by_their_length(tmp_path: Path) -> None:
    names = [DRIVE, "2026_01_01_drive_0002"]
    street.write_drive(tmp_path, names[0], 4)
    street.write_drive(tmp_path, names[1], 8, dense=False, lidar=True)
    with Supervision(tmp_path, names, 6) as examples:
        assert len(examples) == 6
        assert examples.frames_per_drive == {names[0]: 2, names[1]: 4}
        assert examples.size == street.SIZE
        unlabelled = [bool((examples[i].cls == classes.VOID).all()) for i in range(6)]
        assert unlabelled == [False] * 2 + [True] * 4


def _example() -> Example:
    image, depth, cls = street.scene(3)
    return Example(image, street.K, depth.astype(np.float32), cls)


def test_mirror_negates_each_ray_and_twice_is_nothing() -> None:
    example = _example()
    mirror = mirrored(example)
    x, y, _ = np.moveaxis(rays(example.K, street.SIZE), -1, 0)
    mirror_x, mirror_y, _ = np.moveaxis(rays(mirror.K, street.SIZE), -1, 0)
    np.testing.assert_allclose(mirror_x, -x[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(mirror_y, y)
    np.testing.assert_array_equal(mirror.depth_m, example.depth_m[:, ::-1])
    for a, b in zip(vars(mirrored(mirror)).values(), vars(example).values(), strict=True):
        np.testing.assert_allclose(a, b)


def test_light_changes_the_image_alone() -> None:
    example = _example()
    other = relit(example, np.random.default_rng(1))
    assert other.image.dtype == np.uint8
    assert not np.array_equal(other.image, example.image)
    for name in ("K", "depth_m", "cls"):
        np.testing.assert_array_equal(getattr(other, name), getattr(example, name))
    # Equal pixels stay equal: a light is a function of the colour alone.
    _, first = np.unique(example.image.reshape(-1, 3), axis=0, return_inverse=True)
    for group in np.unique(first)[:20]:
        assert len(np.unique(other.image.reshape(-1, 3)[first == group], axis=0)) == 1


def test_points_behind_a_near_edge_are_dropped_and_ground_stays() -> None:
    K = np.array([[360.0, 0, 160], [0, 360, 40], [0, 0, 1]])
    rows = np.arange(100)[:, None]
    ground = np.where(rows > 45, 1.65 * 360 / np.maximum(rows - 40, 1), 0) * np.ones((1, 320))
    ground[:, 1::3] = 0
    np.testing.assert_array_equal(visible(ground, K), ground)
    wall = ground.copy()
    wall[20:80:2, 100:140:2] = 6.0  # a car, and the street that the scanner sees through its points
    kept = visible(wall, K)
    np.testing.assert_array_equal(kept[20:80:2, 100:140:2], 6.0)
    hidden = np.zeros_like(wall, bool)
    hidden[46:79, 100:139] = wall[46:79, 100:139] > 7.5
    assert hidden.any()
    assert not kept[hidden].any()
    np.testing.assert_array_equal(kept[:, :98], ground[:, :98])


@pytest.mark.real
def test_what_stays_of_a_real_scan_agrees_better_with_the_benchmark(real_kitti: Path) -> None:
    """KITTI's depth benchmark has thrown out what the camera cannot see by comparing with the stereo pair."""
    name = "2011_09_26_drive_0001_sync_0000000005_{}_image_02.png"
    folder = real_kitti / "depth_benchmark"
    raw, truth = (read_png(folder / name.format(kind)) / 256 for kind in ("velodyne_raw", "groundtruth"))
    camera = RawDrive(real_kitti / "2011_09_26" / "2011_09_26_drive_0001_sync").camera([2])
    assert camera is not None
    kept = visible(raw, camera.K)
    both = (raw > 0) & (truth > 0)
    wrong = both & (raw > 1.1 * truth)
    assert (wrong & (kept > 0)).sum() < 0.7 * wrong.sum()
    assert (both & ~wrong & (kept > 0)).sum() > 0.99 * (both & ~wrong).sum()
