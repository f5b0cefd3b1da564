from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.geometry import rays
from pipeline.encoder.examples import Example, Examples, mirrored, relit, spread
from tests import street

DRIVE = "2026_01_01_drive_0001"


def test_drives_that_teach_nothing_are_refused(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 3, dense=False, lidar=False)
    street.write_drive(tmp_path, "2026_01_01_drive_0002", 3, images=False)
    with pytest.raises(InputError, match="nothing to learn from"):
        Examples(tmp_path, [DRIVE, "2026_01_01_drive_0002"], 10)


def test_known_is_what_frames_with_an_image_know(tmp_path: Path) -> None:
    names = [DRIVE, "2026_01_01_drive_0002"]
    street.write_drive(tmp_path, names[0], 3)
    street.write_drive(tmp_path, names[1], 3, dense=False, lidar=True, images=False)
    with Examples(tmp_path, names, 6) as examples:
        assert examples.known == {"depth", "cls"}
    street.write_drive(tmp_path, names[1], 3, dense=False, lidar=True)
    with Examples(tmp_path, names, 6) as examples:
        assert examples.known == {"depth", "cls", "lidar"}


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
    with Examples(tmp_path, names, 6) as examples:
        assert len(examples) == 6
        assert examples.frames_per_drive == {names[0]: 2, names[1]: 4}
        assert examples.size == street.SIZE
        unlabelled = [bool((examples[i].cls == classes.VOID).all()) for i in range(6)]
        assert unlabelled == [False] * 2 + [True] * 4


def test_a_teacher_sees_each_frame_without_class_truth_as_it_is_and_once(tmp_path: Path) -> None:
    names = [DRIVE, "2026_01_01_drive_0002"]
    street.write_drive(tmp_path, names[0], 2)
    street.write_drive(tmp_path, names[1], 3, dense=False)
    seen = []

    def teacher(image: np.ndarray, K: np.ndarray) -> np.ndarray:
        seen.append(image)
        np.testing.assert_array_equal(K, street.K)
        return np.full(street.SIZE, classes.CAR, np.uint8)

    with Examples(tmp_path, names, 9, teacher) as examples:
        assert examples.frames_per_drive == {names[0]: 2, names[1]: 3}
        for _ in range(2):
            told = [examples[i].cls for i in range(5)]
        assert len(seen) == 3
        for frame in range(3):
            np.testing.assert_array_equal(seen[frame], street.scene(frame)[0])
            assert (told[2 + frame] == classes.CAR).all()
        np.testing.assert_array_equal(told[1], street.scene(1)[2])
    with Examples(tmp_path, names, 9) as examples:
        assert examples.frames_per_drive == {names[0]: 2, names[1]: 0}


def test_grey_images_are_not_taught(tmp_path: Path) -> None:
    street.write_drive(tmp_path, DRIVE, 3, dense=False)
    with h5py.File(tmp_path / f"{DRIVE}.h5", "r+") as file:
        file.attrs["camera"] = 0
    with pytest.raises(InputError, match="nothing to learn from"):
        Examples(tmp_path, [DRIVE], 9, lambda image, K: image[..., 0])
    street.write_drive(tmp_path, "2026_01_01_drive_0002", 2, dense=False)
    with Examples(tmp_path, [DRIVE, "2026_01_01_drive_0002"], 9, lambda image, K: image[..., 0]) as examples:
        assert examples.taught
        assert examples.frames_per_drive == {DRIVE: 0, "2026_01_01_drive_0002": 2}


def test_some_lights_leave_no_colour() -> None:
    grey = [relit(_example(), np.random.default_rng(seed)).image.std(axis=-1).max() == 0 for seed in range(60)]
    assert 0 < sum(grey) < 30


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
