"""Recordings as drives: rates, times, parts, several files, and plainly wrong files."""

import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import yaml

from footage import convert as conversion
from footage.convert import GAP_S
from pipeline.base.errors import InputError
from pipeline.base.keys import ROOT
from pipeline.base.store import DriveReader
from pipeline.ingest.calibration import read_calibration
from pipeline.ingest.datasets.kitti import KittiDrive
from pipeline.ingest.packets import read_values
from stages import ingest, sample
from stages import labels as labelling
from tests.footage.videos import (
    convert,
    images_of,
    images_of_a_street,
    read,
    replace_in,
    show,
    times_of,
    write_stream,
    write_streams,
)
from tests.kitti_drive import SIZE, pictures, write, write_folder, write_png, write_video


@pytest.mark.parametrize(("fps", "every"), [(4, 1), (14, 1), (15, 2), (25, 2), (29.97, 3), (60, 6)])
def test_every_nth_image_becomes_a_frame(tmp_path, fps, every):
    images = pictures(60)
    convert(tmp_path / "drives", write_folder(tmp_path / "images", images), fps=fps)
    drive = read(tmp_path / "drives")
    np.testing.assert_array_equal(images_of(drive), images[::every])
    np.testing.assert_allclose(times_of(drive), np.arange(60)[::every] / fps, atol=1e-8)
    assert [*drive.images(2)] == [*range(len(images[::every]))]


def test_times_are_those_of_a_file_or_of_a_video(tmp_path):
    """Uneven ones, too; another number of them is refused."""
    images = {"images": pictures(4), "pts": [0, 1, 3, 4]}
    convert(tmp_path / "video", write_streams(tmp_path / "a.mkv", images))
    np.testing.assert_allclose(times_of(read(tmp_path / "video")), [0, 0.1, 0.3, 0.4], atol=1e-6)

    stream = write_video(tmp_path / "a.mjpeg", pictures(3), codec="MJPG")
    times = tmp_path / "times.txt"
    times.write_text("1500000005\n1500000006\n1500000007.5\n")
    convert(tmp_path / "file", stream, times=times)
    assert times_of(read(tmp_path / "file")) == [0, 1, 2.5]
    for number, text in enumerate(("5\n6\n", "5\n6\n7\n8\n")):
        times.write_text(text)
        with pytest.raises(InputError, match=r"has 3 images, but \d times"):
            convert(tmp_path / str(number), stream, times=times)


def test_files_follow_each_other_and_images_are_in_natural_order(tmp_path):
    images = pictures(30)
    paths = []
    for name, rows in (("b", slice(10)), ("a", slice(10, 18)), ("c", slice(18, 30))):
        paths.append(write_video(tmp_path / f"{name}.mp4", images[rows]))
    convert(tmp_path / "joined", paths)
    np.testing.assert_allclose(times_of(read(tmp_path / "joined")), np.arange(30) / 10, atol=1e-3)
    assert np.abs(images_of(read(tmp_path / "joined")).astype(float) - images).mean() < 4

    for number, grey in ((10, 80), (9, 0), (11, 160)):
        write_png(tmp_path / f"folder/img_{number}.png", np.full((*SIZE, 3), grey))
    write(tmp_path / "folder/._img_9.png", "")
    convert(tmp_path / "folder drives", tmp_path / "folder", fps=10)
    greys = images_of(read(tmp_path / "folder drives")).mean(axis=(1, 2, 3))
    assert greys.tolist() == [0, 80, 160]


def test_parts_have_gaps_and_the_values_of_their_log(tmp_path):
    """The log begins at 1 s, ends at 16.9 s, and has a gap of 1 s."""
    rows = [number / 10 for number in range(10, 170) if not 30 < number < 40]
    log = tmp_path / "log.csv"
    log.write_text(
        "time_s,speed_mps,yaw_rate_radps\n" + "".join(f"{t},{t / 2},{t / 100}\n" for t in rows)
    )
    images = write_folder(tmp_path / "images", pictures(200))
    options = {"fps": 10, "motion": log, "camera_height": 1.4}
    convert(tmp_path / "drives", images, shares=[60, 20, 20], **options)

    numbers = []
    for part, first in ((1, 0), (2, 120), (3, 160)):
        drive = read(tmp_path / "drives", part)
        values = read_values(drive.folder / "motion.csv")
        frames = [*drive.images(2)]
        known = {frame: (first + frame) / 10 for frame in frames if (first + frame) / 10 in rows}
        assert values["speed_mps"] == pytest.approx({n: t / 2 for n, t in known.items()}, abs=1e-8)
        assert values["yaw_rate_radps"] == pytest.approx({n: t / 100 for n, t in known.items()})
        numbers += [first + frame for frame in frames]
    assert GAP_S == 2
    assert numbers == [*range(100), *range(120, 140), *range(160, 200)]
    assert read_calibration(tmp_path / "drives", 2).height_m == 1.4

    with pytest.raises(InputError, match=r"monday_drive_0003_sync has no image with a known speed"):
        convert(tmp_path / "short", images, shares=[70, 15, 15], **options, offset=-2.0)
    with pytest.raises(InputError, match=r"part of 5 % has fewer than 2 images \(19.9 s in all\)"):
        convert(tmp_path / "shares", images, shares=[90, 5, 5], fps=10)


def test_a_drive_on_film_has_the_times_values_images_and_labels_of_the_drive(tmp_path, monkeypatch):
    """A rendered drive becomes a video and a log, which become a drive again."""
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["sample"] |= {"image_size": [96, 320], "frames": {"train": 40, "val": 4, "test": 40}}
    params["ingest"] |= {"image_size": [96, 320]}
    name = "2026_01_21_drive_0004"
    params["ingest"]["drives"] = {"train": ["2026_01_01_drive_0001"], "val": [], "test": [name]}
    monkeypatch.chdir(tmp_path)
    Path("params.yaml").write_text(yaml.safe_dump(params))
    sample.main()
    ingest.main()
    labelling.main()

    rendered = KittiDrive(tmp_path / f"data/sample/{name[:10]}/{name}_sync")
    images = images_of(rendered)
    stream = {"images": images, "options": {"crf": "0"}, "pixels": "yuv444p"}
    film = write_streams(tmp_path / "film.mkv", stream)
    with DriveReader(tmp_path / f"data/ingest/{name}.h5", stage="ingest") as file:
        K = file["K"]
        rates = zip(file.time_s, file["speed_mps"], file["yaw_rate_radps"], strict=True)
        rows = [f"{number / 10},{v:.9f},{w:.9f}" for number, (_, v, w) in enumerate(rates)]
    Path("log.csv").write_text("\n".join(["time_s,speed_mps,yaw_rate_radps", *rows]))
    intrinsics = f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"
    lens = {"fov": None, "K": intrinsics, "motion": "log.csv", "png": False}
    convert(tmp_path / "data/raw/monday", film, **lens)

    imported = "monday_drive_0001"
    params["ingest"] |= {"source": "kitti", "drives": {"train": [], "val": [], "test": [imported]}}
    Path("params.yaml").write_text(yaml.safe_dump(params))
    ingest.main()
    before = {}
    with DriveReader(tmp_path / f"data/labels/{name}.h5", stage="labels") as file:
        before = {key: file[key][: len(images)] for key in ("steering_rad", "valid", "speed_mps")}
    labelling.main()
    with (
        DriveReader(tmp_path / f"data/ingest/{imported}.h5", stage="ingest") as raw,
        DriveReader(tmp_path / f"data/labels/{imported}.h5", stage="labels") as file,
    ):
        assert raw.frame.tolist() == [*range(len(images))]
        np.testing.assert_allclose(raw.time_s, np.arange(len(images)) / 10, atol=1e-6)
        assert np.abs(raw["image"].astype(float) - images).mean() < 4
        np.testing.assert_allclose(raw["K"], K, rtol=1e-9)
        np.testing.assert_allclose(file["speed_mps"], before["speed_mps"], atol=1e-6)
        fast = before["speed_mps"] > 3
        assert fast.sum() > 20
        np.testing.assert_array_equal(file["valid"], before["valid"])
        error_rad = np.abs(file["steering_rad"] - before["steering_rad"])
        assert error_rad[fast].max() < 1e-3


def test_a_distorted_image_is_rectified_and_a_large_one_made_smaller(tmp_path):
    K = np.array([[1000.0, 0, 999.5], [0, 1000, 249.5], [0, 0, 1]])
    coefficients = np.array([-0.1, 0.01, 0, 0])
    straight = pictures(2, (500, 2000))[0]
    v, u = np.mgrid[:500, :2000].astype(np.float64)
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, K, coefficients, P=K).astype(np.float32)
    ideal_u, ideal_v = np.moveaxis(ideal.reshape(500, 2000, 2), -1, 0)
    image = cv2.remap(straight, ideal_u, ideal_v, cv2.INTER_LINEAR)
    folder = write_folder(tmp_path / "images", [image, image])
    lens = {"fov": None, "K": "1000,1000,999.5,249.5", "distortion": "-0.1,0.01,0,0"}
    convert(tmp_path / "drives", folder, fps=10, **lens)
    written = images_of(read(tmp_path / "drives"))[0].astype(float)
    expected = cv2.resize(straight, (1242, 310), interpolation=cv2.INTER_AREA)
    assert np.abs(written - expected)[5:-5, 100:-100].max() <= 2
    assert read_calibration(tmp_path / "drives", 2).K[0, 0] == pytest.approx(621)


@pytest.mark.parametrize(("rows", "moved"), [((20.0, 20.5), False), ((20.0, 24.0), True)])
def test_files_of_a_camera_that_was_moved_are_doubted(tmp_path, monkeypatch, rows, moved):
    monkeypatch.setattr(conversion.HorizonFinder, "row", Mock(side_effect=rows))
    paths = [write_video(tmp_path / f"{number}.mp4", pictures(5)) for number in range(2)]
    converted = convert(tmp_path / "drives", paths)
    doubt = "horizons of the files differ by 4 rows of 48: the camera was moved?"
    assert [text.startswith(doubt) for text in converted.doubts] == [True] * moved


def test_a_full_disk_is_noticed_before(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=10))
    images = write_folder(tmp_path / "images", pictures(60))
    with pytest.raises(InputError, match=r"60 images of 64 x 48 pixels take about 0 MB, but 0 MB"):
        convert(tmp_path / "drives", images, fps=10)
    assert "60 images of 64 x 48 pixels take about 0 MB" in capsys.readouterr().err


def orient(path: Path) -> None:
    """Write a PNG with the EXIF orientation 6, a quarter turn."""
    write_png(path, pictures(1)[0])
    exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif
    replace_in(path, b"\0\0\0\0IEND", chunk + struct.pack(">I", 0) + b"\0\0\0\0IEND")


def cut(path: Path) -> None:
    """Write a video with its header at the start, and cut its end off."""
    write_stream(path, 40, "mpeg4", movflags="faststart")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def repeated(path: Path) -> None:
    """Write two copies of a stream, one after the other: timestamps start again."""
    path.write_bytes(write_stream(path, codec="mpeg2video").read_bytes() * 2)


def sizes(path: Path) -> None:
    write_png(path / "1.png", pictures(1)[0])
    write_png(path / "2.png", pictures(1, (40, 64))[0])


def damage(path: Path) -> None:
    """Write a video with zeros in its middle."""
    content = bytearray(write_streams(path, {"images": images_of_a_street()}).read_bytes())
    middle = len(content) // 2
    content[middle : middle + 4000] = bytes(4000)
    path.write_bytes(content)


def numbered(path: Path, *names: str) -> None:
    for name in names:
        write_png(path / name, pictures(1)[0])


PLAINLY_WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("mirrored.mp4", lambda path: show(path, -1, 0, 0, 1), "mirrors"),
    ("side.mp4", lambda path: write_video(path, pictures(2, (64, 48))), "taller than wide"),
    ("avchd.mp4", lambda path: write_stream(path, codec="mpeg4", shape=2), "not square"),
    # FFmpeg assumes 25 frames per second.
    ("raw.h264", lambda path: write_stream(path), "no times. Pass --fps"),
    ("cut.mp4", cut, "of 40 frames"),
    ("cut.mkv", cut, r"of 4\.0 s"),
    ("repeated.ts", repeated, "do not increase"),
    ("exif", lambda path: orient(path / "1.png"), "EXIF orientation"),
    ("sizes", sizes, "has 64 x 40 pixels, expected 64 x 48"),
    ("damaged.mp4", damage, r"damaged at about image \d+, \d+\.\d s.*Copy the file again"),
    ("missing", lambda path: numbered(path, "1.png", "2.png", "4.png"), "rise evenly: 4.png fol"),
    ("cameras", lambda path: numbered(path, "a1.png", "a2.png", "b1.png"), "evenly: b1.png follow"),
    ("empty", lambda path: path.mkdir(), "folder has no images"),
    ("text.mp4", lambda path: path.write_text("not a video"), "cannot be decoded as a video"),
    ("none.mp4", lambda path: None, "path is missing"),
]


@pytest.mark.parametrize(
    ("name", "write", "problem"), PLAINLY_WRONG, ids=[name for name, *_ in PLAINLY_WRONG]
)
def test_plainly_wrong_recordings(tmp_path, name, write, problem):
    path = tmp_path / name
    write(path)
    # Images have no times of their own.
    fps = None if path.suffix else 10
    with pytest.raises(InputError, match=problem) as raised:
        convert(tmp_path / "drives", path, fps=fps)
    assert raised.value.where.startswith(str(path))
