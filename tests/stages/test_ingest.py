"""Stage ingest on small drives in KITTI raw's layout, sound and damaged."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pipeline.base import pool
from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, read_index
from pipeline.camera.geometry import scale_K
from stages import ingest, labels
from tests.kitti_drive import DATE, DRIVE, SIZE, contents, write, write_drive, write_params, write_png

OTHER = "2011_09_26_drive_0002"
NEW = (32, 40)


def run(tmp_path: Path, workers: int = 1, drives: tuple[str, str] = (DRIVE, OTHER), **settings: Any) -> DriveReader:
    """Ingest what lies below ``raw``, and open the first drive's file."""
    params = write_params(tmp_path / "params.yaml", train=[drives[0]], test=[drives[1]], **settings)
    if drives[1] == OTHER and not (tmp_path / "raw" / DATE / f"{OTHER}_sync").exists():
        write_drive(tmp_path / "raw", OTHER, seed=1)
    folder = ingest.main(raw=tmp_path / "raw", out=tmp_path / "data/ingest", params=params, workers=workers)
    assert [path.name for path in folder.parent.iterdir() if not path.name.startswith(".")] == ["ingest"]
    return DriveReader(folder / f"{drives[0]}.h5", stage="ingest")


def pixels(path: Path) -> np.ndarray:
    """Second route to what ingest should store of a picture."""
    return cv2.resize(cv2.imread(str(path)), NEW[::-1], interpolation=cv2.INTER_AREA)[..., ::-1]


def test_everything_of_a_drive(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "raw", truth=True)
    with run(tmp_path) as file:
        np.testing.assert_array_equal(file.frame, [0, 1, 2, 3])
        np.testing.assert_allclose(file.time_s, [0, 0.1, 0.2, 0.3], atol=1e-9)
        oxts = [np.loadtxt(folder / f"oxts/data/{frame:010d}.txt") for frame in range(4)]
        np.testing.assert_array_equal(file["oxts"], oxts)
        for frame in range(4):
            name = f"{frame:010d}"
            np.testing.assert_array_equal(file["image"][frame], pixels(folder / f"image_02/data/{name}.png"))
            points = np.fromfile(folder / f"velodyne_points/data/{name}.bin", np.float32).reshape(-1, 4)
            start, stop = file["lidar_ptr"][frame : frame + 2]
            np.testing.assert_array_equal(file.rows("lidar", start, stop), points)
        K = np.array([[50, 0, 31.3], [0, 50, 22.2], [0, 0, 1]])
        np.testing.assert_allclose(file["K"], scale_K(K, SIZE, NEW))
        assert file["T_cam_velo"].shape == (4, 4)
        for name in ("image", "lidar", "depth", "cls"):
            np.testing.assert_array_equal(file[f"has_{name}"], [1, 1, 1, 1])
        assert (file["depth"].dtype, file.shape("depth")) == (np.uint16, (4, *NEW))
        assert (file["cls"].dtype, file.shape("cls")) == (np.uint8, (4, *NEW))
        assert file.attrs["camera"] == 2
        assert (file.attrs["split"], file.attrs["source"]) == ("train", "kitti")
        assert len(file.attrs["fingerprint"]) == 64
    assert read_index(tmp_path / "data/ingest", stage="ingest") == {DRIVE: "train", OTHER: "test"}


@pytest.mark.slow
def test_files_are_byte_identical_whoever_writes_them_in_whatever_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_drive(tmp_path / "raw", frames=[2, 3, 5, 6, 7, 9], truth=True)
    for name in ("oxts/data/0000000003.txt", "truth/cls/0000000006.png"):
        cut(folder / name)
    (folder / "velodyne_points/data/0000000007.bin").unlink()
    made, logs = [], []
    for workers, size in ((1, 32), (2, 1), (3, 4)):
        monkeypatch.setattr(pool, "BLOCK_FRAMES", size)
        run(tmp_path, workers=workers, on_damaged="skip")
        made.append(contents(tmp_path / "data/ingest"))
        logs.append(re.search(rf"{DRIVE}: (.*) damaged cls left out", capsys.readouterr().out))
    assert made[0] == made[1] == made[2]
    assert {log and log[1] for log in logs} == {
        "5 frames, 5 images, 4 scans, camera 2, 5 depth and 4 class truths, 1 damaged oxts left out, 1"
    }


def test_gaps_go_by_frame_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_drive(tmp_path / "raw", frames=[2, 3, 5, 6, 7])
    (folder / "image_02/data/0000000005.png").unlink()
    (folder / "velodyne_points/data/0000000003.bin").unlink()
    (folder / "oxts/data/0000000006.txt").unlink()
    with run(tmp_path) as file:
        np.testing.assert_array_equal(file.frame, [2, 3, 5, 7])
        np.testing.assert_allclose(file.time_s, [0, 0.1, 0.3, 0.5], atol=1e-9)
        np.testing.assert_array_equal(file["has_image"], [1, 1, 0, 1])
        np.testing.assert_array_equal(file["has_lidar"], [1, 0, 1, 1])
        np.testing.assert_array_equal(file["lidar_ptr"], [0, 200, 200, 400, 600])
        np.testing.assert_array_equal(file["image"][3], pixels(folder / "image_02/data/0000000007.png"))
        assert not file["image"][2].any()
        assert "depth" not in file
        assert "cls" not in file
    text = capsys.readouterr().out
    assert f"{DRIVE}: 4 frames, 3 images, 3 scans, camera 2, 1 without an oxts packet left out" in text


def test_truth_of_some_frames(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "raw", truth=True)
    (folder / "truth/cls/0000000001.png").unlink()
    (folder / "truth/depth/0000000002.png").unlink()
    with run(tmp_path) as file:
        np.testing.assert_array_equal(file["has_cls"], [1, 0, 1, 1])
        np.testing.assert_array_equal(file["has_depth"], [1, 1, 0, 1])
        assert (file["cls"][1] == 255).all(), "absent is void, not road"
        assert not file["depth"][2].any()


def test_grey_drive_without_scans(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_drive(tmp_path / "raw", camera=0, lidar=False)
    (folder / "image_02/data").mkdir(parents=True)  # half-extracted: the colour folder is there, but empty
    with run(tmp_path) as file:
        assert file.attrs["camera"] == 0
        assert file.shape("image") == (4, *NEW, 3)
        np.testing.assert_array_equal(file["image"][1], pixels(folder / "image_00/data/0000000001.png"))
        assert file.shape("lidar") == (0, 4)
        np.testing.assert_array_equal(file["lidar_ptr"], np.zeros(5))
    assert f"no scans: {DRIVE}\n" in capsys.readouterr().out


def test_oxts_alone_is_enough_for_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_drive(tmp_path / "raw", camera=None, lidar=False)
    for path in (tmp_path / "raw" / DATE).glob("calib_*"):
        path.unlink()
    write_drive(tmp_path / "raw", "2011_09_28_drive_0001", seed=1)
    with run(tmp_path, drives=(DRIVE, "2011_09_28_drive_0001")) as file:
        assert "K" not in file
        assert "T_cam_velo" not in file
        assert file.attrs["camera"] == -1
        assert file.shape("image") == (4, *NEW, 3)
        assert not file["has_image"].any()
    text = capsys.readouterr().out
    assert f"{DRIVE}: 4 frames, 0 images, 0 scans, " in text
    assert f"no images: {DRIVE}\nno scans: {DRIVE}\n" in text
    labels.main(tmp_path / "data/ingest", tmp_path / "data/labels", tmp_path / "params.yaml", workers=1)
    assert read_index(tmp_path / "data/labels", stage="labels")[DRIVE] == "train"


def test_lidar_off_reads_no_scans(tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "raw")
    write(folder / "velodyne_points/data/0000000001.bin", "broken")
    with run(tmp_path, lidar=False) as file:
        assert not file["has_lidar"].any()
        assert file["has_image"].all()


def cut(path: Path, share: float = 0.6) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])


SCAN = "velodyne_points/data/0000000001.bin"
DAMAGES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "cut scan": (SCAN, lambda path: write(path, path.read_bytes()[:1601]), "cut short"),
    "scan without its low rings": (SCAN, lambda path: write(path, path.read_bytes()[:1600]), "cut short"),
    "cut image": ("image_02/data/0000000001.png", cut, "cut short"),
    "empty image": ("image_02/data/0000000001.png", lambda path: write(path, ""), "is empty"),
    "cut depth": ("truth/depth/0000000001.png", cut, "cut short"),
    "cut packet": ("oxts/data/0000000001.txt", cut, "of 30 oxts columns"),
    "NaN in a packet": ("oxts/data/0000000001.txt", lambda path: write(path, "nan " * 30), "lat is nan"),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_frame_ends_the_stage_and_leaves_what_was_there(tmp_path: Path, damage: str) -> None:
    folder = write_drive(tmp_path / "raw", truth=True)
    run(tmp_path)
    before = contents(tmp_path / "data/ingest")
    name, break_it, message = DAMAGES[damage]
    break_it(folder / name)
    with pytest.raises(InputError, match=message) as error:
        run(tmp_path)
    assert str(folder / name) in str(error.value)
    assert "ingest.on_damaged: skip" in str(error.value)
    assert contents(tmp_path / "data/ingest") == before


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_frame_is_left_out_and_counted(tmp_path: Path, damage: str, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_drive(tmp_path / "raw", truth=True)
    name, break_it, _ = DAMAGES[damage]
    break_it(folder / name)
    kind = {"velodyne_points": "lidar", "image_02": "image", "truth": "depth", "oxts": "oxts"}[name.split("/")[0]]
    with run(tmp_path, on_damaged="skip") as file:
        np.testing.assert_array_equal(file.frame, [0, 2, 3] if kind == "oxts" else [0, 1, 2, 3])
        for present in ("image", "lidar", "depth", "cls"):
            expected = [1, 0, 1, 1] if present == kind else [1] * len(file.frame)
            np.testing.assert_array_equal(file[f"has_{present}"], expected)
    assert f"1 damaged {kind} left out" in capsys.readouterr().out


def swap_times(folder: Path) -> None:
    path = folder / "oxts/timestamps.txt"
    lines = path.read_text().splitlines()
    write(path, "\n".join([lines[1], lines[0], *lines[2:]]))


def forget_calibration(folder: Path, line: str) -> None:
    path = folder.parent / "calib_cam_to_cam.txt"
    write(path, "\n".join(text for text in path.read_text().splitlines() if not text.startswith(line)))


FAULTS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "time goes backwards": (swap_times, r"oxts/timestamps.txt: time goes from .* it must increase"),
    "no times": (lambda folder: (folder / "oxts/timestamps.txt").unlink(), r"timestamps.txt is missing: extract"),
    "no packets": (lambda folder: shutil.rmtree(folder / "oxts/data"), r"oxts/data holds no packets"),
    "image of another size": (
        lambda folder: write_png(folder / "image_02/data/0000000002.png", np.zeros((50, 64, 3), np.uint8)),
        r"0000000002.png is 64 x 50 pixels, the calibration says 64 x 48",
    ),
    "no camera calibration": (
        lambda folder: (folder.parent / "calib_cam_to_cam.txt").unlink(),
        r"calib_cam_to_cam.txt is missing",
    ),
    "camera not calibrated": (lambda folder: forget_calibration(folder, "P_rect_02"), r"has no P_rect_02"),
    "scans not calibrated": (
        lambda folder: (folder.parent / "calib_velo_to_cam.txt").unlink(),
        r"lacks .*calib_velo_to_cam.txt",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("on_damaged", ["fail", "skip"])
def test_faults_of_a_whole_drive_are_errors_always(tmp_path: Path, fault: str, on_damaged: str) -> None:
    folder = write_drive(tmp_path / "raw")
    run(tmp_path, on_damaged=on_damaged)
    before = contents(tmp_path / "data/ingest")
    break_it, message = FAULTS[fault]
    break_it(folder)
    with pytest.raises(InputError, match=message):
        run(tmp_path, on_damaged=on_damaged)
    assert contents(tmp_path / "data/ingest") == before


def test_only_changed_drives_are_read_again_after_a_failure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_drive(tmp_path / "raw")
    folder = write_drive(tmp_path / "raw", OTHER, seed=1)
    picture = folder / "image_02/data/0000000000.png"
    whole = picture.read_bytes()
    cut(picture)
    with pytest.raises(InputError, match="cut short"):
        run(tmp_path)
    picture.write_bytes(whole)
    run(tmp_path)
    assert "1 of 2 drives kept from the run before" in capsys.readouterr().out


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "stages.ingest", *map(str, arguments)], capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_raw_data_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    raw, out = tmp_path / "raw", tmp_path / "out"
    params = write_params(tmp_path / "params.yaml", train=[DRIVE], test=[OTHER])
    arguments = ("--raw", raw, "--town", tmp_path / "town", "--out", out, "--params", params)

    def error() -> str:
        ended = command(*arguments)
        assert ended.returncode == 1
        assert ended.stderr.count("\n") == 1
        assert not out.exists()
        return ended.stderr

    assert f"error: {raw} is missing. Link it: ln -s /path/to/kitti {raw}." in error()
    raw.mkdir()
    assert f"error: {raw} holds no drives" in error()
    write_drive(raw)
    assert f"error: {raw} has no drive {OTHER}, named in ingest.drives: did you mean {DRIVE}?" in error()
    write_params(params, train=[DRIVE], test=[DRIVE])
    assert f"{DRIVE} is named twice" in error()
    write_params(params, train=[DRIVE], test=[OTHER], source="town")
    assert f"error: {tmp_path / 'town'} is missing. Make it: dvc repro town" in error()


@pytest.mark.slow
def test_town_is_read_from_its_own_folder(tmp_path: Path) -> None:
    for seed, drive in enumerate([DRIVE, OTHER]):
        write_drive(tmp_path / "town", drive, seed=seed)
    params = write_params(tmp_path / "params.yaml", train=[DRIVE], test=[OTHER], source="town")
    ended = command(
        "--town", tmp_path / "town", "--raw", tmp_path / "raw", "--out", tmp_path / "out", "--params", params
    )
    assert ended.returncode == 0, ended.stderr
    assert list(read_index(tmp_path / "out", stage="ingest")) == [DRIVE, OTHER]


def test_of_both_each_drive_comes_from_its_own_folder(tmp_path: Path) -> None:
    sample = "2026_01_01_drive_0001"
    write_drive(tmp_path / "raw", DRIVE)
    write_drive(tmp_path / "town", sample, frames=range(2), truth=True)
    params = write_params(tmp_path / "params.yaml", train=[DRIVE], test=[sample], source="both")
    folders = {"town": tmp_path / "town", "raw": tmp_path / "raw", "out": tmp_path / "out"}
    ingest.main(**folders, params=params, workers=1)
    assert read_index(tmp_path / "out", stage="ingest") == {DRIVE: "train", sample: "test"}
    for drive, source, frames in ((DRIVE, "kitti", 4), (sample, "town", 2)):
        with DriveReader(tmp_path / f"out/{drive}.h5", stage="ingest") as file:
            assert (file.attrs["source"], len(file.frame)) == (source, frames)
            assert ("cls" in file) == (source == "town")
    write_drive(tmp_path / "raw", sample)
    with pytest.raises(InputError, match=rf"{sample} lies in .*raw, but with ingest.source: both what is called 2026_"):
        ingest.main(**folders, params=params, workers=1)
    shutil.rmtree(tmp_path / "raw")
    with pytest.raises(InputError, match=r"raw is missing\. Link it"):
        ingest.main(**folders, params=params, workers=1)


@pytest.mark.real
def test_real_drives(real_kitti: Path, tmp_path: Path) -> None:
    """Drive 0001 is partly extracted: 108 packets, one image and one scan. 0042 is grey and has no LiDAR."""
    partly, grey = "2011_09_26_drive_0001", "2011_10_03_drive_0042"
    params = write_params(tmp_path / "params.yaml", train=[partly], test=[grey], image_size=[96, 320])
    ingest.main(raw=real_kitti, out=tmp_path / "data/ingest", params=params, workers=1)
    with DriveReader(tmp_path / f"data/ingest/{partly}.h5", stage="ingest") as file:
        np.testing.assert_array_equal(file.frame, np.arange(108))
        assert np.flatnonzero(file["has_image"]).tolist() == np.flatnonzero(file["has_lidar"]).tolist() == [5]
        assert file.shape("lidar") == (121_948, 4)
        assert file["image"][5].std() > 30
    with DriveReader(tmp_path / f"data/ingest/{grey}.h5", stage="ingest") as file:
        assert file["has_image"].all()
        assert file.shape("image") == (51, 96, 320, 3)
        assert file.attrs["camera"] == 0
        assert np.ptp(file["image"], axis=-1).max() == 0
        assert np.diff(file.time_s) == pytest.approx(0.1037, abs=0.02)


def test_a_frame_that_was_extracted_again_is_read_again(tmp_path: Path) -> None:
    """Its drive waits, finished, for the next run, and the new file has the old one's size and time."""
    write_drive(tmp_path / "raw")
    other = write_drive(tmp_path / "raw", OTHER, seed=1)
    scan = tmp_path / "raw" / DATE / f"{DRIVE}_sync/velodyne_points/data/0000000002.bin"
    damaged = other / "velodyne_points/data/0000000001.bin"
    sound = damaged.read_bytes()
    damaged.write_bytes(b"cut")
    with pytest.raises(InputError, match="is cut short"):
        run(tmp_path)
    assert len(list((tmp_path / "data/.resume/ingest").glob("*.h5"))) == 1
    damaged.write_bytes(sound)
    before, points = scan.stat(), np.fromfile(scan, np.float32).reshape(-1, 4)
    points[:, 3] = 0.5
    scan.write_bytes(points.tobytes())
    os.utime(scan, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert scan.stat().st_size == before.st_size
    with run(tmp_path) as file:
        start, stop = file["lidar_ptr"][2:4]
        np.testing.assert_array_equal(file.rows("lidar", start, stop), points)
