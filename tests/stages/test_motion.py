"""Stage motion on drives that turn, stand, or lack images."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import to_units
from pipeline.kitti.ingest import ingest_drive
from pipeline.kitti.oxts import make_rows
from pipeline.motion.step import PROBLEMS
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception
from stages import motion
from tests import street

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_02_drive_0001": "val", "2026_01_03_drive_0001": "test"}
TURNS, STANDS, BLIND = SPLITS
NUMBERS = np.array([3, 4, 5, 7, 8], np.int32)  # 6 is missing
RATES = 0.3, 6.0


def write_drive(root: Path, drive: str, poses: list[np.ndarray]) -> None:
    """Write files of stages ingest and perception; a drive without poses has no images."""
    views = [street.view(pose) for pose in poses]
    frames = [Frame(number, number / 10) for number in NUMBERS.tolist()]
    for frame, (image, *_) in zip(frames, views, strict=False):
        frame.image = image
    wrong = dict(zip(NUMBERS.tolist(), make_rows(len(frames), vf=99.0, wu=9.0), strict=True))  # must not be read
    camera = Camera(street.WIDE.K, street.WIDE.size) if poses else None
    reading = Reading(image_size=street.WIDE.size, cameras=[2], lidar=True, on_damaged="fail")
    ingest_drive(frames, root / f"ingest/{drive}.h5", drive=drive, camera=camera, settings=reading, oxts=wrong)
    params = {"perception": Perception(batch=1).model_dump()}
    with store.DriveWriter(root / f"perception/{drive}.h5", stage="perception", drive=drive, params=params) as file:
        file.attrs["camera_height_m"] = 1.65
        file.put("frame", NUMBERS[: len(views)])
        file.put("time_s", NUMBERS[: len(views)] / 10)
        units = np.array([to_units(depth) for _, depth, _ in views], np.uint16)
        file.put("depth_m", units.reshape(-1, *street.WIDE.size))
        file.put("cls", np.array([cls for *_, cls in views], np.uint8).reshape(-1, *street.WIDE.size))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("motion")
    poses = street.arc(6, *RATES)
    write_drive(root, TURNS, [poses[number - 3] for number in NUMBERS])
    write_drive(root, STANDS, [street.pose(0, 0, 5)] * 5)
    write_drive(root, BLIND, [])
    store.write_index(root / "perception", SPLITS)
    motion.main(root / "ingest", root / "perception", root / "motion", workers=1)
    return root


def opened(root: Path, drive: str) -> store.DriveReader:
    return store.DriveReader(root / "motion" / f"{drive}.h5", stage="motion")


def test_motion_since_the_previous_frame_by_number(root: Path) -> None:
    assert store.read_index(root / "motion", stage="motion") == SPLITS
    with opened(root, TURNS) as file:
        assert file.frame.tolist() == NUMBERS.tolist()
        assert file["valid"].tolist() == [0, 1, 1, 0, 1]
        valid = file["valid"] > 0
        assert file["yaw_rate_radps"][valid] == pytest.approx(RATES[0], abs=0.01)
        assert file["speed_mps"][valid] == pytest.approx(RATES[1], rel=0.03)
        assert file["filtered_mps"][valid] == pytest.approx(RATES[1], rel=0.03)
        assert (file["inliers"][valid] > 100).all()
        assert not any(file[name][~valid].any() for name in ("yaw_rate_radps", "speed_mps", "filtered_mps"))
        assert file["T_before"][1][2, 3] == pytest.approx(0.6, rel=0.03)
        assert file["road_height_m"] == pytest.approx(1.65, rel=0.03)
        assert file.params == {"perception": Perception(batch=1).model_dump()}


def test_a_drive_without_motion_or_frames(root: Path) -> None:
    with opened(root, STANDS) as file:
        assert not file["valid"].any()
        assert not file["speed_mps"].any()
        assert [PROBLEMS[code] for code in file["problem"]][1] == "the image does not move"
    with opened(root, BLIND) as file:
        assert file.shape("frame") == (0,)
        assert file.shape("T_before") == (0, 4, 4)
