from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.camera import Camera
from pipeline.camera.geometry import rays
from pipeline.perception import examples as module
from pipeline.perception.examples import Example, Examples, mirrored, relit, spread
from tests import street

DENSE, LIDAR, BARE, BLIND, GREY = DRIVES = [f"2026_01_01_drive_000{number}" for number in range(1, 6)]


@pytest.fixture(scope="module")
def ingest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ingest")
    street.write_drive(folder, DENSE, 4)
    street.write_drive(folder, LIDAR, 8, dense=False, lidar=True)
    street.write_drive(folder, BARE, 3, dense=False)
    street.write_drive(folder, BLIND, 3, lidar=True, images=False)
    street.write_drive(folder, GREY, 3, dense=False)
    with h5py.File(folder / f"{GREY}.h5", "r+") as file:
        file["image"][:] = file["image"][..., :1]  # still camera 2, like a grey video that was imported
    return folder


def all_car(image: np.ndarray, camera: Camera) -> np.ndarray:
    return np.full(image.shape[:2], classes.CAR, np.uint8)


@pytest.mark.parametrize(("drives", "teacher"), [([BARE, BLIND], None), ([GREY], all_car)])
def test_drives_without_targets_are_refused(ingest: Path, drives: list[str], teacher: object) -> None:
    with pytest.raises(InputError, match="no frame of the training drives") as raised:
        Examples(ingest, drives, 10, teacher)  # type: ignore[arg-type]
    assert "LiDAR" in raised.value.fix


@pytest.mark.parametrize(
    ("drives", "expected"), [([DENSE, BLIND], {"depth", "cls"}), ([DENSE, LIDAR], {"depth", "cls", "lidar"})]
)
def test_ground_truth_belongs_to_frames_with_an_image(ingest: Path, drives: list[str], expected: set[str]) -> None:
    with Examples(ingest, drives, 6) as examples:
        assert examples.ground_truth == expected
    with Examples(ingest, drives, 6, all_car, unlabelled=drives) as examples:
        assert not examples.ground_truth
        assert not examples[0].depth_m.any()
        assert (examples[0].cls == classes.CAR).all()


@pytest.mark.parametrize(("count", "wanted"), [(10, 3), (10, 10), (10, 99), (1000, 7), (20573, 20000)])
def test_spread_is_even_and_without_repeats(count: int, wanted: int) -> None:
    rows = spread(count, wanted)
    assert len(rows) == min(count, wanted)
    steps = np.diff(rows)
    assert steps.min() >= 1
    assert steps.max() - steps.min() <= 1


def test_a_teacher_classifies_each_colour_frame_without_labels_once(ingest: Path) -> None:
    inputs = []

    def teacher(image: np.ndarray, camera: Camera) -> np.ndarray:
        inputs.append(image)
        np.testing.assert_array_equal(camera.K, street.K)
        return all_car(image, camera)

    with Examples(ingest, [DENSE, BARE, GREY], 9, teacher) as examples:
        assert examples.has_teacher
        assert examples.grey == module.GREY_OF_TEACHER > module.GREY
        assert examples.frames_per_drive == {DENSE: 4, BARE: 3, GREY: 0}
        for _ in range(2):
            cls = [examples[i].cls for i in range(7)]
    np.testing.assert_array_equal(inputs, [street.scene(frame)[0] for frame in range(3)])
    assert (np.array(cls[4:]) == classes.CAR).all()
    np.testing.assert_array_equal(cls[1], street.scene(1)[2])


@pytest.fixture
def example() -> Example:
    image, depth, cls = street.scene(3)
    return Example(image, street.CAMERA, depth.astype(np.float32), cls)


def test_mirroring_negates_the_rays_and_is_its_own_inverse(example: Example) -> None:
    mirror = mirrored(example)
    x, y, _ = np.moveaxis(rays(street.K, street.SIZE), -1, 0)
    mirror_x, mirror_y, _ = np.moveaxis(rays(mirror.camera.K, street.SIZE), -1, 0)
    np.testing.assert_allclose(mirror_x, -x[:, ::-1], atol=1e-12)
    np.testing.assert_allclose(mirror_y, y)
    np.testing.assert_array_equal(mirror.depth_m, example.depth_m[:, ::-1])
    back = mirrored(mirror)
    np.testing.assert_allclose(back.camera.K, street.K)
    for name in ("image", "depth_m", "cls"):
        np.testing.assert_array_equal(getattr(back, name), getattr(example, name))


@pytest.mark.parametrize(("grey", "expected"), [(0.0, 0), (0.5, 32), (1.0, 64)])
def test_a_share_of_the_images_loses_its_colour_and_keeps_its_classes(
    example: Example, grey: float, expected: int
) -> None:
    rng = np.random.default_rng(0)
    results = [relit(example, rng, grey) for _ in range(64)]
    assert sum(not np.ptp(result.image, axis=-1).any() for result in results) == pytest.approx(expected, abs=10 * grey)
    assert all(result.cls is example.cls for result in results)
