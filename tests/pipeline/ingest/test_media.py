"""The order and the times of images, from folders and from videos that follow each other."""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.ingest import media
from pipeline.ingest.video import Video
from tests.kitti_drive import SIZE, pictures, write_png, write_video
from tests.pipeline.ingest.videos import (
    images_of_a_street,
    open_recording,
    times_of,
    write_streams,
)


def test_order_and_times_follow_the_numbers_in_names(tmp_path):
    greys = {"img_10.png": 80, "img_9.png": 0, "img_13.JPG": 160, "._img_9.png": 9}
    for name, grey in greys.items():
        write_png(tmp_path / name, np.full((*SIZE, 3), grey))
    opaque = np.full((*SIZE, 4), [7, 7, 7, 255], np.uint8)
    cv2.imwrite(str(tmp_path / "img_11.png"), opaque)
    (tmp_path / "notes.txt").write_text("not an image")

    frames = list(open_recording(tmp_path, fps=4).frames())
    assert [frame.image.mean() for frame in frames] == [0, 80, 7, 160]
    assert [frame.number for frame in frames] == [0, 1, 2, 3]
    assert [frame.time_s for frame in frames] == [0, 0.25, 0.5, 1.0]

    write_png(tmp_path / "rear_9.png", np.zeros((*SIZE, 3)))
    with pytest.raises(InputError, match=r"rear_9.png would follow img_13.JPG: .*two cameras"):
        open_recording(tmp_path, fps=4)


def test_files_that_follow_each_other_are_one_recording(tmp_path):
    """Also a folder of them, part 9 before part 10."""
    images = pictures(30)
    whole = open_recording(write_video(tmp_path / "whole.mp4", images))
    (tmp_path / "folder").mkdir()
    parts = []
    for number, rows in ((9, slice(10)), (10, slice(10, 18)), (11, slice(18, 30))):
        parts.append(write_video(tmp_path / f"folder/part {number}.mp4", images[rows]))
    for paths in (parts, tmp_path / "folder"):
        joined = open_recording(paths)
        np.testing.assert_allclose(joined.times_s, whole.times_s, atol=1e-3)
        decoded = np.stack([frame.image for frame in joined.frames()]).astype(float)
        assert np.abs(decoded - images).mean() < 4


def test_a_gap_between_two_files_is_in_the_times():
    """An overlap is only named."""
    videos = []
    for time in ("2026-11-26 12:00:00", "2026-11-26 12:00:10", "2026-11-26 12:00:12", None):
        path = Path(f"{len(videos)}.mp4")
        created = pd.Timestamp(time)
        videos.append(Video(path, 40, 40, True, 0.0, 3.9, 0.1, created, np.nan, []))
    begins_s, notes = media.follow(videos)
    assert begins_s == [0, 10, 14, 18]
    assert notes == [
        "1.mp4 begins 6.0 s after the end of 0.mp4",
        "2.mp4 begins 2.0 s before the end of 1.mp4",
    ]


def test_doubts_on_the_order_of_files(tmp_path):
    """By the numbers in names, or else the times at which videos were created."""

    def video(name: str, frames: int, created: str) -> Path:
        path = tmp_path / f"{name}.mp4"
        path.parent.mkdir(exist_ok=True)
        return write_streams(path, {"images": pictures(frames)}, created=f"2026-11-26T{created}")

    first = video("part_1", 5, "12:00:00")
    second = video("part_2", 6, "12:00:01")
    assert open_recording([first, second]).doubts == []
    assert open_recording([second, first]).doubts == [
        "part_1.mp4 follows part_2.mp4, unlike the numbers in their names: is the order right?"
    ]

    first = video("other/a", 5, "12:00:00")
    second = video("other/b", 6, "12:00:01")
    earlier = video("other/c", 7, "11:00:00")
    assert open_recording([first, second]).doubts == []
    assert open_recording([first, earlier]).doubts == [
        "c.mp4 follows a.mp4, but was created 3600 s earlier: is the order of the files right?"
    ]


def test_a_picture_beside_videos_is_ignored(tmp_path):
    first = write_video(tmp_path / "part_1.mp4", pictures(5))
    write_video(tmp_path / "part_2.mp4", pictures(6))
    write_png(tmp_path / "thumb.png", pictures(1)[0])
    recording = open_recording(tmp_path)
    assert recording.path == first
    assert recording.notes == ["the folder's 2 videos are used, not thumb.png"]


@pytest.mark.parametrize("taken_hz", [7.5, 120.0])
def test_time_lapse_and_slow_motion_need_their_rate(tmp_path, taken_hz):
    """By the tag of phones."""
    stream = {"images": images_of_a_street()[:20], "fps": 30}
    path = write_streams(
        tmp_path / "a.mp4", stream, taken_hz=taken_hz, movflags="use_metadata_tags"
    )
    problem = f"{taken_hz:g} images per second were taken, 30 are.* --fps {taken_hz:g}"
    with pytest.raises(InputError, match=problem):
        open_recording(path)
    assert open_recording(path, fps=taken_hz).times_s[1] == pytest.approx(1 / taken_hz)


@pytest.mark.parametrize(("taken_hz", "uneven"), [(26.0, False), (31.0, False), (60.0, True)])
def test_a_similar_rate_or_one_that_varies_is_no_time_lapse(tmp_path, taken_hz, uneven):
    """Rates vary in the dark."""
    stream = {"images": images_of_a_street()[:20], "fps": 30}
    if uneven:
        stream["pts"] = np.cumsum([1, 2] * 10).tolist()
    path = write_streams(
        tmp_path / "a.mp4", stream, taken_hz=taken_hz, movflags="use_metadata_tags"
    )
    assert len(open_recording(path).times_s) == 20


def test_names_in_nanoseconds_are_times(tmp_path):
    for stamp in (1479424215880976321, 1479424215930976321, 1479424216040976321):
        write_png(tmp_path / f"{stamp}.png", pictures(1)[0])
    assert times_of(tmp_path) == pytest.approx([0, 0.05, 0.16], abs=1e-12)


def test_times_are_those_of_a_file(tmp_path):
    """Also those of a raw stream; another number of them is refused."""
    path = write_video(tmp_path / "a.mjpeg", pictures(3), codec="MJPG")
    times = tmp_path / "times.txt"
    times.write_text("5\n6\n7.5\n")
    assert times_of(path, times=times) == [5, 6, 7.5]
    for text in ("5\n6\n", "5\n6\n7\n8\n"):
        times.write_text(text)
        with pytest.raises(InputError, match=r"times"):
            times_of(path, times=times)
