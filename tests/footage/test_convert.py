"""Recordings as drives: rates, times, parts, several files, and plainly wrong files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from footage.convert import GAP_S, Converted
from pipeline.base.errors import InputError
from pipeline.base.summary import split_doubts
from pipeline.ingest.calibration import read_calibration
from pipeline.ingest.datasets import kitti
from pipeline.ingest.packets import read_values
from pipeline.ingest.write import write_drive
from pipeline.labels.label_file import open_labels
from pipeline.labels.settings import Labels
from pipeline.labels.source import labels_drive
from pipeline.train.entry import Entry
from pipeline.train.targets import read_drive as read_labelled
from pipeline.train.windows import split_spans
from steer.measure import READING
from tests.artefacts import write_graphs
from tests.footage.videos import (
    convert,
    images_of,
    read,
    show,
    times_of,
    write_stream,
    write_streams,
)
from tests.kitti_drive import SIZE, pictures, write, write_folder, write_png, write_video


@pytest.mark.parametrize(("fps", "every"), [(4, 1), (14, 1), (15, 2), (29.97, 3)])
def test_every_nth_image_becomes_a_frame(tmp_path, fps, every):
    images = pictures(60)
    convert(tmp_path / "drives", write_folder(tmp_path / "images", images), fps=fps)
    drive = read(tmp_path / "drives")
    np.testing.assert_array_equal(images_of(drive), images[::every])
    np.testing.assert_allclose(times_of(drive), np.arange(60)[::every] / fps, atol=1e-8)
    assert [*drive.find_images(2)] == [*range(len(images[::every]))]


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
    for name, images in (("stopped", STOPPED), ("slow", SLOW)):
        path = write_streams(tmp_path / f"{name}.mkv", images)
        convert(tmp_path / name, path, fps=10)
        expected_s = np.arange(len(images["images"])) / 10
        np.testing.assert_allclose(times_of(read(tmp_path / name)), expected_s, atol=1e-8)

    times.write_text("5\n6\n")
    with pytest.raises(InputError, match=r"has 3 images, but 2 times"):
        convert(tmp_path / "fewer", stream, times=times)


def test_files_follow_each_other_and_images_are_in_natural_order(tmp_path):
    images = pictures(30)
    paths = []
    for name, rows in (("b", slice(10)), ("a", slice(10, 18)), ("c", slice(18, 30))):
        paths.append(write_video(tmp_path / f"{name}.mp4", images[rows]))
    joined = convert(tmp_path / "joined", paths)
    assert joined.notes[1] == "a.mp4: 8 images, 0.8 s, taken to begin at 1.0 s"
    with pytest.raises(InputError, match=r"b\.mp4: is passed twice"):
        convert(tmp_path / "twice", [*paths, tmp_path / "folder/../b.mp4"])
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
    text = "time_s,speed_mps,yaw_rate_radps\n"
    log.write_text(text + "".join(f"{t},{t / 2},{t / 100}\n" for t in rows))
    images = write_folder(tmp_path / "images", pictures(200))
    options = {"fps": 10, "motion": log, "camera_height": 1.4}
    convert(tmp_path / "drives", images, shares=[60, 20, 20], **options)

    numbers = []
    for part, first in ((1, 0), (2, 120), (3, 160)):
        drive = read(tmp_path / "drives", part)
        values = read_values(drive.folder / "motion.csv")
        frames = [*drive.find_images(2)]
        known = {frame: (first + frame) / 10 for frame in frames if (first + frame) / 10 in rows}
        assert values["speed_mps"] == pytest.approx({n: t / 2 for n, t in known.items()}, abs=1e-8)
        numbers += [first + frame for frame in frames]
    assert GAP_S == 2
    assert numbers == [*range(100), *range(120, 140), *range(160, 200)]
    assert read_calibration(tmp_path / "drives", 2).height_m == 1.4

    with pytest.raises(InputError, match=r"part of 5 % has fewer than 2 images \(19.9 s in all\)"):
        convert(tmp_path / "shares", images, shares=[90, 5, 5], fps=10)


# Times of images of which 60 s are missing, as those of a dashcam's two files, and their numbers.
BROKEN_S = [*(np.arange(30) / 10), *(62.9 + np.arange(30) / 10)]
NUMBERS = [*range(30), *range(629, 659)]


@pytest.fixture
def broken(tmp_path) -> Converted:
    """Convert these images to the folder ``drives``, with a log: 8 m/s, and the angle rises."""
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{time_s:.3f}\n" for time_s in BROKEN_S))
    log = tmp_path / "log.csv"
    rows = "".join(f"{time_s:.3f},8,0.1,{time_s / 100:.4f}\n" for time_s in BROKEN_S)
    log.write_text(f"time_s,speed_mps,yaw_rate_radps,wheel_rad\n{rows}")
    images = write_folder(tmp_path / "images", pictures(60))
    logs = {"motion": log, "wheel": log, "steering_ratio": 1.0}
    return convert(tmp_path / "drives", images, times=times, **logs)


def test_a_gap_in_time_leaves_out_the_numbers_of_missing_images(tmp_path, broken):
    """Images, times and logs have the numbers of the images that exist, as in KITTI."""
    drive = read(tmp_path / "drives")
    assert [*drive.find_images(2)] == NUMBERS
    np.testing.assert_array_equal(images_of(drive), pictures(60))
    np.testing.assert_allclose(times_of(drive), BROKEN_S, atol=1e-8)
    expected_rad = dict(zip(NUMBERS, np.array(BROKEN_S) / 100, strict=True))
    angles_rad = read_values(drive.folder / "steering.csv")["steering_rad"]
    assert angles_rad == pytest.approx(expected_rad, abs=1e-4)
    speeds_mps = read_values(drive.folder / "motion.csv")["speed_mps"]
    assert speeds_mps == dict.fromkeys(NUMBERS, 8.0)
    note = "gaps in time: 1, the longest of 60.0 s after frame 29; the next frame is 629"
    assert any(note in line for line in broken.notes)

    # An image that is removed later changes no other's time.
    (drive.folder / "image_02/data/0000000640.png").unlink()
    np.testing.assert_allclose(times_of(read(tmp_path / "drives")), np.delete(BROKEN_S, 41))


def test_no_path_window_or_target_crosses_a_gap_in_time(tmp_path, broken):
    """A path of 5 m takes 0.625 s, so the last seven frames of a part have none."""
    opened = kitti.read_drive(read(tmp_path / "drives"), READING)
    write_drive(tmp_path / "ingest.h5", opened, "a", "kitti", READING)
    assert split_doubts(opened.notes) == (["gaps in the numbers of frames: 1"], [])
    settings = Labels(wheelbase_m=2.7, min_speed_mps=1.0, ahead_m=[0.0, 5.0])
    labels_drive(tmp_path / "labels/a.h5", tmp_path / "ingest.h5", settings=settings)
    with open_labels(tmp_path / "labels/a.h5") as file:
        assert file.frame.tolist() == NUMBERS
        assert np.flatnonzero(file["ahead_valid"]).tolist() == [*range(23), *range(30, 53)]
        angle_rad = file["steering_rad"]

    write_graphs(tmp_path / "graphs/a.h5", angle_rad, np.array(NUMBERS), points=8)
    options: dict[str, Any] = {"input": "graphs", "spatial": "gnn", "temporal": "lstm"}
    entry = Entry.model_validate({**options, "semantics": 1.0, "window": 4, "horizon": 10})
    folders = (tmp_path / name for name in ("graphs", "labels", "motion"))
    drive = read_labelled(*folders, "a", entry)
    assert drive.stretches == [(0, 30), (30, 60)]
    assert np.flatnonzero(np.isfinite(drive.target[:, 0])).tolist() == [*range(20), *range(30, 50)]
    for span in split_spans([drive], window=4, windows=5):
        assert span.stop <= 30 or span.start >= 30


@pytest.mark.parametrize(
    ("steps_s", "expected"),
    [
        ([0.1, 0.1, 1.0, 0.1], [0, 1, 2, 3, 4]),
        ([0.1, 0.1, 1.5, 0.1], [0, 1, 2, 17, 18]),
        # Time lapse, and gaps of days.
        ([1.5, 1.5, 4.0, 1.5], [0, 1, 2, 3, 4]),
        ([1.5, 1.5, 6.0, 1.5], [0, 1, 2, 6, 7]),
        ([0.1, 0.1, 1e6, 0.1], [0, 1, 2, 10003, 10004]),
    ],
)
def test_a_gap_is_much_longer_than_a_step(tmp_path, steps_s, expected):
    times_s = np.cumsum([0.0, *steps_s])
    times = tmp_path / "times.txt"
    times.write_text("".join(f"{time_s:.3f}\n" for time_s in times_s))
    images = write_folder(tmp_path / "images", pictures(5))
    convert(tmp_path / "drives", images, times=times)
    drive = read(tmp_path / "drives")
    assert [*drive.find_images(2)] == expected
    np.testing.assert_allclose(times_of(drive), times_s, atol=1e-8)


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


# Images whose times are all 0, since Matroska rounds to a millisecond.
STOPPED = {"images": pictures(12), "codec": "mpeg4", "fps": 60000}
# Images with the times 0 to 2 ms.
SLOW = STOPPED | {"images": pictures(120)}


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
    images = np.random.default_rng(0).integers(0, 256, (60, *SIZE, 3), np.uint8)
    content = bytearray(write_streams(path, {"images": images}).read_bytes())
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
    ("stopped.mkv", lambda path: write_streams(path, STOPPED), "12 images, 1 time. Pass --fps N"),
    ("slow.mkv", lambda path: write_streams(path, SLOW), "120 images, 3 times. Pass --fps N"),
    ("cut.mp4", cut, r"of 4\.0 s"),
    ("cut.mkv", cut, r"of 4\.0 s"),
    ("repeated.ts", repeated, "do not increase"),
    ("sizes", sizes, "has 64 x 40 pixels, expected 64 x 48"),
    ("damaged.mp4", damage, r"damaged at about image \d+, \d+\.\d s.*Copy the file again"),
    ("missing", lambda path: numbered(path, "1.png", "2.png", "4.png"), "rise evenly: 4.png fol"),
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
