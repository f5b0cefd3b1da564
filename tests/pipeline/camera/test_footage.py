"""Recordings are read image by image, in order and on time; what is wrong with them is said in one line."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.base.resume import ROOT
from pipeline.camera import footage
from pipeline.camera.footage import ImageFolder, Video, open_footage
from tests.footage import SIZE, pictures, write_folder, write_video
from tests.kitti_drive import write_png


def test_a_folder_gives_its_images_as_they_are(tmp_path: Path) -> None:
    images = pictures(5)
    opened = open_footage(write_folder(tmp_path / "a", images), fps=4)
    assert (opened.size, opened.fps, opened.count) == (SIZE, 4, 5)
    frames = list(opened.frames())
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_s for frame in frames] == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_array_equal([frame.image for frame in frames], images)


def test_a_folder_alone_knows_no_times(tmp_path: Path) -> None:
    opened = open_footage(write_folder(tmp_path, pictures(2)))
    assert [frame.time_s for frame in opened.frames()] == [None, None]


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        (["img_10.png", "img_9.png", "img_100.png"], ["img_9", "img_10", "img_100"]),
        (["b.png", "a.png", "c.JPG"], ["a", "b", "c"]),
        (["a-2_1.png", "a-1_2.png", "a-1_10.png"], ["a-1_2", "a-1_10", "a-2_1"]),
        (["01.png", "1.png", "0.png"], ["0", "01", "1"]),
    ],
)
def test_order_is_that_of_the_numbers_in_the_names(tmp_path: Path, names: list[str], ordered: list[str]) -> None:
    for name in names:
        write_png(tmp_path / name, pictures(1)[0])
    (tmp_path / "notes.txt").write_text("not an image")
    opened = open_footage(tmp_path)
    assert isinstance(opened, ImageFolder)
    assert [file.stem for file in opened.files] == ordered


def test_jpeg_and_grey_images(tmp_path: Path) -> None:
    image = pictures(1)[0]
    write_png(tmp_path / "0.jpeg", image)
    write_png(tmp_path / "1.png", image[..., 0])
    coloured, grey = (frame.image for frame in open_footage(tmp_path).frames())
    assert np.abs(coloured.astype(int) - image).mean() < 4  # blue is not red
    assert (grey == image[..., :1]).all()


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
def test_a_video_gives_images_and_the_times_of_its_container(tmp_path: Path, kind: str) -> None:
    images = pictures(12)
    opened = open_footage(write_video(tmp_path / f"a.{kind}", images, fps=12.5))
    assert isinstance(opened, Video)
    assert (opened.size, opened.fps, opened.count) == (SIZE, 12.5, 12)
    frames = list(opened.frames())
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(12) / 12.5, atol=1e-3)
    assert opened.untimed_from is None
    assert np.abs(np.array([frame.image for frame in frames], float) - images).mean() < 4
    assert len(list(opened.frames())) == 12  # once more


def test_a_frame_rate_that_the_user_knows_better(tmp_path: Path) -> None:
    opened = open_footage(write_video(tmp_path / "a.mp4", pictures(3), fps=25), fps=10)
    assert [frame.time_s for frame in opened.frames()] == pytest.approx([0, 0.1, 0.2])


@pytest.mark.parametrize(
    ("stamps", "times", "start"),
    [
        ([0, 0, 0, 0], [0, 0.1, 0.2, 0.3], 0),  # a stream without timestamps
        ([5, 5.2, 5.1, 9], [0, 0.2, 0.3, 0.4], 1),
        ([5, 5.2, 5.3, 5.9], [0, 0.2, 0.3, 0.9], None),
    ],
)
def test_timestamps_are_followed_while_they_increase(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stamps: list[float], times: list[float], start: int | None
) -> None:
    left = iter(stamps)
    monkeypatch.setattr(footage, "_position_s", lambda _: next(left))
    opened = open_footage(write_video(tmp_path / "a.mp4", pictures(4), fps=10))
    assert isinstance(opened, Video)
    assert [frame.time_s for frame in opened.frames()] == pytest.approx(times)
    assert opened.untimed_from == start


def test_neither_timestamps_nor_a_frame_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(footage, "_position_s", lambda _: 0.0)
    opened = open_footage(write_video(tmp_path / "a.mp4", pictures(3)))
    opened.fps = None
    with pytest.raises(DamagedFile, match="neither timestamps nor a frame rate: say --fps"):
        list(opened.frames())


def test_images_of_mixed_sizes(tmp_path: Path) -> None:
    write_folder(tmp_path, [pictures(1)[0], pictures(1, (40, 64))[0]])
    with pytest.raises(InputError, match=r"000001.png is 64 x 40 pixels, the first image is 64 x 48"):
        list(open_footage(tmp_path).frames())


@pytest.mark.parametrize("kind", ["avi", "mkv"])
def test_a_video_that_ends_early_gives_what_it_has_and_says_so(tmp_path: Path, kind: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, *SIZE, 3), np.uint8)
    path = write_video(tmp_path / f"a.{kind}", noise, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames, seen = open_footage(path).frames(), list[int]()
    with pytest.raises(DamagedFile, match=rf"ends after \d+ of the 40 images that it announces.*whole.{kind}"):
        seen.extend(frame.number for frame in frames)
    assert 5 < len(seen) < 35


@pytest.mark.parametrize("content", ["", "hello\n"])
def test_what_is_no_video(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.mp4").write_text(content)
    with pytest.raises(DamagedFile, match=r"a.mp4 cannot be decoded as a video"):
        open_footage(tmp_path / "a.mp4")


def test_ffmpeg_is_silent(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_text("")
    script = f"""
from pathlib import Path
from pipeline.base.errors import DamagedFile
from pipeline.camera.footage import open_footage
try:
    open_footage(Path({str(tmp_path / "a.mp4")!r}))
except DamagedFile:
    print("refused")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert (done.stdout, done.stderr) == ("refused\n", "")


def test_a_cut_mp4(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", pictures(9))
    path.write_bytes(path.read_bytes()[:-900])  # its table stands at the end
    with pytest.raises(DamagedFile, match="cut short or of another kind"):
        open_footage(path)


def test_what_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no images: PNG and JPEG files"):
        open_footage(tmp_path)
    with pytest.raises(InputError, match=r"nothing.mp4 is missing: name a video file, or a folder"):
        open_footage(tmp_path / "nothing.mp4")


def test_deep_pixels_are_said(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros(SIZE, np.uint16))
    with pytest.raises(DamagedFile, match="has uint16 pixels, 8 bits per channel"):
        open_footage(tmp_path)
