"""Stage motion on drives that turn, stand, or lack images and scans."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.camera.camera import Camera, Frame
from pipeline.camera.images import to_units
from pipeline.kitti.ingest_file import ingest_drive
from pipeline.kitti.oxts import make_rows
from pipeline.motion import motion_file
from pipeline.settings.ingest import Reading
from pipeline.settings.perception import Perception
from stages import motion
from tests import rendered_street as street
from tests.pipeline.motion.test_lidar import T_CAM_VELO, scan, world

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_02_drive_0001": "val", "2026_01_03_drive_0001": "test"}
TURNS, STANDS, BLIND = SPLITS
NUMBERS = np.array([3, 4, 5, 7, 8])  # 6 is missing
RATES = 0.3, 6.0


def write_drive(root: Path, drive: str, poses: list[np.ndarray], *, images: bool = True, scans: bool = True) -> None:
    views = [street.view(pose) for pose in poses] if images else []
    frames = [Frame(number, number / 10) for number in NUMBERS.tolist()]
    for row, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
        frame.image = views[row][0] if images else None
        points = scan(row, pose, world()).scan if scans else None
        frame.scan = None if points is None else np.pad(points, [(0, 0), (0, 1)])
    ingest_drive(
        frames,
        root / "ingest" / f"{drive}.h5",
        drive=drive,
        camera=Camera(street.K, street.SIZE, T_cam_velo=T_CAM_VELO if scans else None) if images or scans else None,
        settings=Reading(image_size=street.SIZE, cameras=[2], lidar=True, on_damaged="fail"),
        oxts=dict(
            zip(NUMBERS.tolist(), make_rows(len(poses), vf=99.0, wu=9.0), strict=True)
        ),  # wrong: must not be read
    )
    params = {"perception": Perception(batch=1).model_dump()}
    with store.DriveWriter(root / "perception" / f"{drive}.h5", stage="perception", drive=drive, params=params) as file:
        file.attrs["camera_height_m"] = 1.65
        file.put("frame", NUMBERS[: len(views)])
        file.put("time_s", NUMBERS[: len(views)] / 10)
        file.put("depth_m", np.array([to_units(depth) for _, depth, _ in views], np.uint16).reshape(-1, *street.SIZE))
        file.put("cls", np.array([cls for *_, cls in views], np.uint8).reshape(-1, *street.SIZE))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("motion")
    poses = street.arc(6, *RATES)
    write_drive(root, TURNS, [poses[number - 3] for number in NUMBERS])
    write_drive(root, STANDS, [street.pose(0, 0, 5)] * 5)
    write_drive(root, BLIND, [np.eye(4)] * 5, images=False, scans=False)
    store.write_index(root / "perception", SPLITS)
    run(root, "motion")
    return root


def run(root: Path, name: str, kinds: tuple[str, ...] = ("visual", "lidar")) -> None:
    (root / "params.yaml").write_text(yaml.safe_dump({"motion": {"kinds": list(kinds)}}))
    out = motion.main(root / "ingest", root / "perception", root / name, root / "params.yaml", workers=1)
    assert out == root / name


def opened(root: Path, kind: str, drive: str) -> store.DriveReader:
    return store.DriveReader(root / "motion" / kind / f"{drive}.h5", stage="motion")


@pytest.mark.parametrize("kind", ["visual", "lidar"])
def test_motion_since_the_previous_frame_by_number(root: Path, kind: str) -> None:
    assert store.read_index(root / "motion" / kind, stage="motion") == SPLITS
    with opened(root, kind, TURNS) as file:
        assert (file.frame.tolist(), file.frame.dtype) == (NUMBERS.tolist(), np.int32)
        assert file["valid"].tolist() == [0, 1, 1, 0, 1]
        valid = file["valid"] > 0
        assert file["yaw_rate_radps"][valid] == pytest.approx(RATES[0], abs=0.01)
        assert file["speed_mps"][valid] == pytest.approx(RATES[1], rel=0.03)
        assert (file["inliers"][valid] > 100).all()
        for name in ("yaw_rate_radps", "speed_mps", "inliers", "residual"):
            assert (file[name][~valid] == 0).all()
        assert (file["T_before"][~valid] == np.eye(4)).all()
        assert file["T_before"][1][2, 3] == pytest.approx(0.6, rel=0.03)
        assert ("scale" in file) == (kind == "visual")
        assert file.params["motion"]["kinds"] == ["visual", "lidar"]


def test_the_index_has_the_share_of_frames_with_a_road(root: Path) -> None:
    index = store.read_json(root / "motion/index.json", stage="motion", form=motion_file.Index)
    assert index["kinds"] == ["lidar", "visual"]
    assert 0 < index["road_frames"] <= 1  # of ten frames of TURNS and STANDS; BLIND has none
    assert motion_file.uncertain_scale(root / "motion") == ""


@pytest.mark.parametrize("kind", ["visual", "lidar"])
def test_a_drive_without_motion_or_frames(root: Path, kind: str) -> None:
    with opened(root, kind, STANDS) as file:
        assert file["valid"].tolist() == [0] * 5
        assert not file["speed_mps"].any()
    with opened(root, kind, BLIND) as file:
        assert file.shape("frame") == (0,)
        assert file.shape("T_before") == (0, 4, 4)


def test_of_an_obsolete_kind_only_written_files_are_removed(root: Path) -> None:
    run(root, "again")
    (root / "again/lidar/scans.bin").touch()
    run(root, "again", ("visual",))
    assert [path.name for path in (root / "again/lidar").iterdir()] == ["scans.bin"]
