"""Stage ingest on small drives in KITTI raw's layout, intact and damaged."""

import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, read_index
from pipeline.camera.camera import Camera
from pipeline.ingest.calibration import CALIBRATION, RENDERED
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.packets import COLUMNS
from stages import ingest
from tests.kitti_drive import (
    DATE,
    DRIVE,
    LINES,
    SIZE,
    contents,
    write,
    write_drive,
    write_params,
    write_png,
)

OTHER = "2011_09_26_drive_0002"
NEW = (36, 48)


def run(tmp_path: Path, **settings: Any) -> DriveReader:
    """Ingest DRIVE and OTHER below ``raw``; open the file of DRIVE."""
    params = write_params(tmp_path / "params.yaml", train=[DRIVE], test=[OTHER], **settings)
    if not (tmp_path / "raw" / DATE / f"{OTHER}_sync").exists():
        write_drive(tmp_path / "raw", OTHER, seed=1)
    folder = ingest.main(tmp_path / "data", tmp_path / "raw", params)
    return open_ingest(folder / f"{DRIVE}.h5")


def test_a_gap_in_time_between_neighbouring_numbers_is_doubted(tmp_path, capsys):
    folder = write_drive(tmp_path / "raw")
    run(tmp_path)
    assert "doubt" not in capsys.readouterr().out
    seconds = [25.0, 25.1, 45.2, 45.3]
    stamps = "".join(f"2011-09-26 13:02:{second:.9f}\n" for second in seconds)
    write(folder / "oxts/timestamps.txt", stamps)
    run(tmp_path)
    doubt = f"\ndoubt: {DRIVE}: frames 1 and 2 are 20.1 s apart, but count as consecutive"
    assert doubt in capsys.readouterr().out


def test_rows_go_by_frame_number(tmp_path):
    """Frame 5 lacks its image, 3 its scan, and 6 its packet."""
    folder = write_drive(tmp_path / "raw", frames=[2, 3, 5, 6, 7], truth=True)
    images = folder / "image_02/data"
    scans = folder / "velodyne_points/data"
    (images / "0000000005.png").unlink()
    (scans / "0000000003.bin").unlink()
    (folder / "oxts/data/0000000006.txt").unlink()

    # Frame 3 is a JPEG file. Frame 7 is in both formats: the PNG file is read.
    noise = np.random.default_rng(9).integers(0, 256, (*SIZE, 3), np.uint8)
    write_png(images / "0000000003.JPEG", noise)
    (images / "0000000003.png").unlink()
    write_png(images / "0000000007.jpg", noise)
    for junk in ("._0000000003.bin", "0000000003.bin.part", "readme.txt"):
        write(scans / junk, "")

    with run(tmp_path) as file:
        np.testing.assert_array_equal(file.frame, [2, 3, 5, 7])
        np.testing.assert_allclose(file.time_s, [0, 0.1, 0.3, 0.5], atol=1e-9)
        np.testing.assert_array_equal(file["has_image"], [1, 1, 0, 1])
        np.testing.assert_array_equal(file["has_lidar"], [1, 0, 1, 1])
        np.testing.assert_array_equal(file["has_cls"], [1, 1, 1, 1])

        oxts = [np.loadtxt(folder / f"oxts/data/{frame:010d}.txt") for frame in file.frame]
        np.testing.assert_array_equal(file["oxts"], oxts)
        for name, column in {"speed_mps": "vf", "left_mps": "vl", "yaw_rate_radps": "wu"}.items():
            np.testing.assert_array_equal(file[name], np.array(oxts)[:, COLUMNS.index(column)])

        for row, name in ((1, "0000000003.JPEG"), (3, "0000000007.png")):
            image = cv2.imread(str(images / name))[..., ::-1]
            image = cv2.resize(image, NEW[::-1], interpolation=cv2.INTER_AREA)
            np.testing.assert_array_equal(file["image"][row], image)
        assert not file["image"][2].any()

        np.testing.assert_array_equal(file["lidar_ptr"], [0, 200, 200, 400, 600])
        points = np.fromfile(scans / "0000000005.bin", np.float32).reshape(-1, 4)
        np.testing.assert_array_equal(file.row("lidar", slice(200, 400)), points)

        K = np.array([[50, 0, 31.3], [0, 50, 22.2], [0, 0, 1]])
        np.testing.assert_allclose(file["K"], Camera(K, SIZE).scaled(NEW).K)
        assert file["T_cam_velo"].shape == (4, 4)
    assert read_index(tmp_path / "data/ingest", stage="ingest") == {DRIVE: "train", OTHER: "test"}


def test_damaged_files_are_listed_at_once_or_left_out(tmp_path, capsys):
    folder = write_drive(tmp_path / "raw", truth=True)
    run(tmp_path)
    before = contents(tmp_path / "data/ingest")
    names = (
        "velodyne_points/data/0000000001.bin",
        "image_02/data/0000000002.png",
        "oxts/data/0000000003.txt",
    )
    for name in names:
        write(folder / name, (folder / name).read_bytes()[:-60])
    with pytest.raises(InputError, match="3 damaged files") as raised:
        run(tmp_path)
    for name in names:
        assert str(folder / name) in str(raised.value)
    assert contents(tmp_path / "data/ingest") == before
    with run(tmp_path, on_damaged="skip") as file:
        np.testing.assert_array_equal(file.frame, [0, 1, 2])
        assert file["has_lidar"].tolist() == [1, 0, 1]
        assert file["has_image"].tolist() == [1, 1, 0]
        assert file["has_depth"].tolist() == [1, 1, 1]
    assert "3 damaged files left out" in capsys.readouterr().out

    for scan in (folder / "velodyne_points/data").iterdir():
        write(scan, scan.read_bytes()[:-60])
    problem = "bin: all scans of the drive are damaged: scan is cut short"
    with pytest.raises(InputError, match=problem):
        run(tmp_path, on_damaged="skip")

    for packet in (folder / "oxts/data").iterdir():
        write(packet, "")
    problem = "0.txt: all packets of the drive are damaged: expected 30"
    with pytest.raises(InputError, match=problem):
        run(tmp_path, on_damaged="skip")


@pytest.mark.parametrize(
    ("missing", "problem"),
    [
        ("../calib_cam_to_cam.txt", "calib_cam_to_cam.txt: file is missing. Extract the date's"),
        ("../calib_velo_to_cam.txt", "drive has scans"),
        ("oxts/data", "no oxts packets"),
        ("oxts/timestamps.txt", "file is missing"),
    ],
)
def test_plainly_incomplete_drives(tmp_path, missing, problem):
    write_drive(tmp_path / "raw", OTHER)
    path = write_drive(tmp_path / "raw") / missing
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    with pytest.raises(InputError, match=problem):
        run(tmp_path)


def test_another_frame_rate_than_in_training_is_printed(tmp_path, capsys):
    write_drive(tmp_path / "raw")
    run(tmp_path)
    assert "doubt" not in capsys.readouterr().out
    stamps = [f"2011-09-26 13:02:{25 + i / 5:06.3f}\n" for i in range(LINES)]
    write(tmp_path / f"raw/{DATE}/{OTHER}_sync/oxts/timestamps.txt", "".join(stamps))
    for _ in range(2):  # The second run keeps all drives.
        run(tmp_path)
        doubt = f"doubt: the usual rate is 10.0 frames/s, but {OTHER} 5.0\n"
        assert capsys.readouterr().out.endswith(doubt)


def test_missing_drives_are_named_before_any_drive_is_read(tmp_path):
    missing = "2011_09_26_drive_0003"
    write_drive(tmp_path / "raw")
    params = write_params(tmp_path / "params.yaml", train=[DRIVE, missing], test=[OTHER])
    problem = f"raw/{DATE}/{missing}_sync: drive is missing, and so are {OTHER}. Extract"
    with pytest.raises(InputError, match=problem):
        ingest.main(tmp_path / "data", tmp_path / "raw", params)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("name", ["0000000001.tif", ".DS_Store"])
def test_a_folder_without_images_is_empty(tmp_path, name):
    """Half-extracted archives have empty folders. Files of another format or name are a fault."""
    folder = write_drive(tmp_path / "raw") / "image_02"
    image = (folder / "data/0000000001.png").read_bytes()
    shutil.rmtree(folder)
    write(folder / f"data/{name}", "")
    refused = pytest.raises(InputError, match=f"{folder}/data: has no image .got {name}, exp")
    with refused if name[0] != "." else nullcontext():
        assert not run(tmp_path)["has_image"].any()
    folder.rename(folder.with_name("image_00"))  # a camera that is not needed
    write(folder / "data/0000000001.png", image)
    assert run(tmp_path)["has_image"].tolist() == [0, 1, 0, 0]


def test_drives_of_the_sample_are_those_that_were_rendered(tmp_path):
    sample = "2026_01_01_drive_0001"
    tested = "2026_01_02_drive_0001"
    for drive in (sample, tested):
        folder = write_drive(tmp_path / "data/sample", drive, frames=range(2), truth=True)
        calibration = folder.parent / CALIBRATION
        write(calibration, f"{RENDERED}\n{calibration.read_text()}")
    params = write_params(tmp_path / "params.yaml", train=[sample], test=[tested], source="sample")
    ingest.main(tmp_path / "data", tmp_path / "raw", params)
    assert read_index(tmp_path / "data/ingest", stage="ingest") == {sample: "train", tested: "test"}
    with open_ingest(tmp_path / f"data/ingest/{sample}.h5") as file:
        assert len(file.frame) == 2
        assert file.params["dataset"] == "sample"
        assert "cls" in file
