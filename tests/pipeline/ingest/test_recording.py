"""Recordings: frames nearest to a rate, and plainly wrong files."""

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from tests import street
from tests.kitti_drive import pictures, write_folder, write_png, write_video
from tests.pipeline.ingest.videos import (
    images_of_a_street,
    open_recording,
    replace_in,
    show,
    write_stream,
    write_streams,
)


@pytest.mark.parametrize(
    ("hz", "fps", "steps"),
    [(10, 30, {3}), (9.64, 29, {3}), (10, 25, {2, 3}), (10, 24, {2, 3}), (10, 11, {1})],
)
def test_frames_nearest_to_a_rate(tmp_path, hz, fps, steps):
    recording = open_recording(write_folder(tmp_path / "images", pictures(60)), fps=fps)
    recording.resample(hz)
    assert {*np.diff(recording.kept).tolist()} == steps
    assert recording.times_s.tolist() == (recording.kept / fps).tolist()
    kept_hz = fps if steps == {1} else hz
    assert len(recording.times_s) == pytest.approx(60 / fps * kept_hz, abs=1)
    assert len(list(recording.frames())) == len(recording.kept)


@pytest.mark.parametrize(
    ("fps", "hz"), [(14, None), (15, 7.5), (25, 12.5), (29.97, 9.99), (60, 10)]
)
def test_about_ten_frames_a_second_are_kept_of_a_fast_recording(tmp_path, fps, hz):
    path = write_folder(tmp_path / "images", pictures(60))
    recording = open_recording(path, fps=fps)
    assert recording.reduce() == hz
    every = round(fps / hz) if hz else 1
    assert recording.kept.tolist() == list(range(0, 60, every))
    if hz:  # as the preset of an import has it
        assert open_recording(path, fps=fps, hz=hz).kept.tolist() == recording.kept.tolist()


def test_a_recording_that_is_slower_than_asked_is_refused(tmp_path):
    path = write_folder(tmp_path / "images", pictures(60))
    with pytest.raises(InputError, match=r"has 7.0 frames/s, expected 10.0 or more"):
        open_recording(path, fps=7, hz=10)


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


def two_cameras(path: Path) -> None:
    write_png(path / "thumb.png", pictures(1)[0])
    for number, name in enumerate(
        ("12-00-00-front", "12-00-00-back", "12-01-00-front", "12-01-00-back")
    ):
        write_video(path / f"2026-05-01_{name}.mp4", pictures(2 + number))


def two_recordings(path: Path) -> None:
    path.mkdir()
    for number, name in enumerate(("GX010042", "GX020042", "GX010043")):
        write_video(path / f"{name}.mp4", pictures(2 + number))


def stereo(path: Path, axis: int) -> None:
    """Write images of a rendered stereo camera, side by side or one above the other."""
    T_left_right = np.eye(4)
    T_left_right[0, 3] = 0.25
    images = []
    for pose in street.arc(3, 0.1, 8.0):
        left, _, _ = street.view(pose)
        right, _, _ = street.view(pose @ T_left_right)
        images.append(np.concatenate([left, right], axis))
    write_video(path, images)


PLAINLY_WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("mirrored.mp4", lambda path: show(path, -1, 0, 0, 1), "mirrors"),
    ("avchd.mp4", lambda path: write_stream(path, codec="mpeg4", shape=2), "not square"),
    # FFmpeg assumes 25 frames per second.
    ("raw.h264", lambda path: write_stream(path), "no times"),
    ("cut.mp4", cut, "of 40 frames"),
    ("cut.mkv", cut, r"of 4\.0 s"),
    ("repeated.ts", repeated, "do not increase"),
    ("exif", lambda path: orient(path / "1.png"), "EXIF orientation"),
    ("sizes", sizes, "image 1 has 64 x 40 pixels .*64 x 48"),
    ("damaged.mp4", damage, r"damaged at about image \d+, \d+\.\d s.*Copy the file again"),
    (
        "cameras",
        two_cameras,
        r"2 cameras or recordings: \*-back.mp4, \*-front.mp4\. Pass the files of one",
    ),
    ("chapters", two_recordings, r"2 cameras or recordings: GX\*0042.mp4, GX010043.mp4"),
    ("side.mp4", lambda path: stereo(path, 1), "side by side.* crop=iw/2:ih:0:0 left.mp4"),
    ("above.mp4", lambda path: stereo(path, 0), "above the other.* crop=iw:ih/2:0:0 upper.mp4"),
    (
        os.fsdecode(b"stra\xdfe.mp4"),
        lambda path: write_stream(path.with_name("a.mp4")).rename(path),
        "not UTF-8",
    ),
    ("text.mp4", lambda path: path.write_text("not a video"), "cannot be decoded as a video"),
    ("none.mp4", lambda path: None, "missing"),
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
        list(open_recording(path, fps=fps).frames())
    assert raised.value.where.startswith(str(path).encode(errors="replace").decode())
