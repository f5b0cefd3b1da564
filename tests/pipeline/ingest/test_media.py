"""Recordings: frames, times, logs, and plainly wrong files."""

import os
import re
import socket
import struct
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pandas as pd
import pytest
from av.stream import Disposition

from pipeline.base.errors import DamagedFile, InputError
from pipeline.ingest import media, recording, video
from pipeline.ingest.log import Log, log_notes, read_logs, read_times
from pipeline.ingest.names import group, order_doubts
from pipeline.ingest.recording import Recording
from pipeline.ingest.settings import RecordingOptions
from pipeline.motion.step import durations
from tests import street
from tests.kitti_drive import SIZE, pictures, write_folder, write_png, write_video


def open_recording(paths: Path | list[Path], **options: Any) -> Recording:
    """Open a recording of a lens of 80 degrees."""
    options = {"fov": 80.0, **options}
    return recording.open_recording(
        [paths] if isinstance(paths, Path) else paths, RecordingOptions(**options)
    )


def times_of(path: Path, **options: Any) -> list[float]:
    return [frame.time_s for frame in open_recording(path, **options).frames()]


def test_order_and_times_follow_the_numbers_in_names(tmp_path):
    for name, grey in {
        "img_10.png": 80,
        "img_9.png": 0,
        "img_13.JPG": 160,
        "img_11.png": 7,
        "._img_9.png": 9,
    }.items():
        write_png(tmp_path / name, np.full((*SIZE, 3), grey))
    # opaque
    cv2.imwrite(str(tmp_path / "img_11.png"), np.full((*SIZE, 4), [7, 7, 7, 255], np.uint8))
    (tmp_path / "notes.txt").write_text("not an image")
    frames = list(open_recording(tmp_path, fps=4).frames())
    assert [frame.image.mean() for frame in frames if frame.image is not None] == [0, 80, 7, 160]
    assert [(frame.number, frame.time_s) for frame in frames] == [
        (0, 0),
        (1, 0.25),
        (2, 0.5),
        (3, 1.0),
    ]
    write_png(tmp_path / "rear_9.png", np.zeros((*SIZE, 3)))
    with pytest.raises(InputError, match=r"rear_9.png would follow img_13.JPG: .*two cameras"):
        open_recording(tmp_path, fps=4)


def test_files_that_follow_each_other_are_one_recording(tmp_path):
    """Also a folder of them, part 9 before part 10. A gap between two is in the times, an overlap
    is only named.
    """
    images = pictures(30)
    whole, parts = open_recording(write_video(tmp_path / "whole.mp4", images)), list[Path]()
    (tmp_path / "folder").mkdir()
    for number, rows in ((9, slice(10)), (10, slice(10, 18)), (11, slice(18, 30))):
        parts.append(write_video(tmp_path / f"folder/part {number}.mp4", images[rows]))
    for paths in (parts, parts[0].parent):
        joined = open_recording(paths)
        np.testing.assert_allclose(joined.times_s, whole.times_s, atol=1e-3)
        found = np.stack([frame.image for frame in joined.frames()]).astype(float)
        assert np.abs(found - images).mean() < 4
    times = "2026-11-26 12:00:00", "2026-11-26 12:00:10", "2026-11-26 12:00:12", None
    videos = [
        video.Video(Path(f"{n}.mp4"), 40, 40, True, 0.0, 3.9, 0.1, pd.Timestamp(t), np.nan, [])
        for n, t in enumerate(times)
    ]
    begins_s, notes = media.follow(videos)
    assert begins_s == [0, 10, 14, 18]
    assert notes == [
        "1.mp4 begins 6.0 s after the end of 0.mp4",
        "2.mp4 begins 2.0 s before the end of 1.mp4",
    ]


NAMES = {
    "part_10 part_9": ["part_9 part_10"],
    "2024-05-01_13-00-00-front 2024-05-01_12-59-00-front": [
        "2024-05-01_12-59-00-front 2024-05-01_13-00-00-front"
    ],
    "2024-05-01_12-00-00-back 2024-05-01_12-00-00-front": [
        "2024-05-01_12-00-00-back",
        "2024-05-01_12-00-00-front",
    ],
    "20240501_120000_EF 20240501_115900_NF": ["20240501_115900_NF 20240501_120000_EF"],
    "20240501_120000_NF 20240501_120000_NR": ["20240501_120000_NF", "20240501_120000_NR"],
    "NO20240501-120000-000001F NO20240501-120100-000002F": [
        "NO20240501-120000-000001F NO20240501-120100-000002F"
    ],
    "GX020042 GX010043 GX010042": ["GX010042 GX020042", "GX010043"],
    "GP010042 GP020042 GOPR0042": ["GOPR0042 GP010042 GP020042"],
    "DJI_0002 DJI_0001": ["DJI_0001 DJI_0002"],
    "DJI_20240501120000_0001_D DJI_20240501115000_0000_D": [
        "DJI_20240501115000_0000_D DJI_20240501120000_0001_D"
    ],
    "cam2_1 cam1_1 cam1_2 cam1_3": ["cam1_1 cam1_2 cam1_3", "cam2_1"],
    "12-59-00 13-00-00": ["12-59-00 13-00-00"],
}


@pytest.mark.parametrize(("names", "recordings"), NAMES.items())
def test_files_of_one_recording_differ_in_one_rising_number(names, recordings):
    groups = group([Path(f"{name}.mp4") for name in names.split()])
    assert sorted(" ".join(path.stem for path in paths) for paths in groups.values()) == recordings


def test_doubts_on_the_order_of_files(tmp_path):
    """By the numbers in names, or else the times at which videos were created; a picture beside
    videos is ignored.
    """
    stream = {"images": pictures(5)}
    first = write_streams(tmp_path / "part_1.mp4", stream, created="2026-11-26T12:00:00")
    second = write_streams(
        tmp_path / "part_2.mp4", stream | {"images": pictures(6)}, created="2026-11-26T12:00:01"
    )
    write_png(tmp_path / "thumb.png", pictures(1)[0])
    assert open_recording([first, second]).doubts == []
    assert open_recording([second, first]).doubts == [
        "part_1.mp4 follows part_2.mp4, unlike the numbers in their names: is the order right?"
    ]
    recording = open_recording(tmp_path)
    assert recording.path == first
    assert recording.notes == ["the folder's 2 videos are used, not thumb.png"]
    early, late = first.rename(tmp_path / "a.mp4"), second.rename(tmp_path / "b.mp4")
    (tmp_path / "c").mkdir()
    last = write_streams(
        tmp_path / "c/c.mp4", {"images": pictures(7)}, created="2026-11-26T11:00:00"
    )
    assert open_recording([early, late]).doubts == []
    assert open_recording([early, last]).doubts == [
        "c.mp4 follows a.mp4, but was created 3600 s earlier: is the order of the files right?"
    ]
    turns = [tmp_path / f"{name}.mp4" for name in ("1_front", "1_back", "2_front", "2_back")]
    assert order_doubts(turns)[0].startswith("files of *_back.mp4 and *_front.mp4 take turns")


def test_time_lapse_and_slow_motion_need_their_rate(tmp_path):
    """By the tag of phones; a rate that varies, as in the dark, is a video's own."""
    stream = {"images": images_of_a_street()[:20], "fps": 30}
    for taken_hz in (7.5, 120.0):
        path = write_streams(
            tmp_path / f"{taken_hz}.mp4", stream, taken_hz=taken_hz, movflags="use_metadata_tags"
        )
        with pytest.raises(
            InputError,
            match=f"{taken_hz:g} images per second were taken, 30 are.* --fps {taken_hz:g}",
        ):
            open_recording(path)
        assert open_recording(path, fps=taken_hz).times_s[1] == pytest.approx(1 / taken_hz)
    uneven = stream | {"pts": np.cumsum([1, 2] * 10).tolist()}
    for taken_hz, healthy in ((26.0, stream), (31.0, stream), (60.0, uneven)):
        open_recording(
            write_streams(
                tmp_path / "a.mp4", healthy, taken_hz=taken_hz, movflags="use_metadata_tags"
            )
        )


def test_black_bars_and_interlaced_fields_are_said(tmp_path):
    images = [np.pad(image, [(8, 6), (0, 0), (0, 0)]) for image in images_of_a_street()[:5]]
    stream = {"images": images, "codec": "mpeg4", "options": {"flags": "+ilme+ildct"}}
    fields, bars = open_recording(write_streams(tmp_path / "a.mp4", stream)).notes
    assert fields.endswith("ffmpeg -i a.mp4 -vf bwdif=send_frame progressive.mp4")
    assert re.search(r"crop=320:9\d:0:8 cropped.mp4, cx - 0 and cy - 8", bars)


def test_times_are_those_of_a_file_or_of_names_in_nanoseconds(tmp_path):
    """Also those of a raw stream; another number of them is refused."""
    for stamp in (1479424215880976321, 1479424215930976321, 1479424216040976321):
        write_png(tmp_path / f"stamps/{stamp}.png", pictures(1)[0])
    assert times_of(tmp_path / "stamps") == pytest.approx([0, 0.05, 0.16], abs=1e-12)
    path, times = (
        write_video(tmp_path / "a.mjpeg", pictures(3), codec="MJPG"),
        tmp_path / "times.txt",
    )
    times.write_text("5\n6\n7.5\n")
    assert times_of(path, times=times) == [5, 6, 7.5]
    for text in ("5\n6\n", "5\n6\n7\n8\n"):
        times.write_text(text)
        with pytest.raises(InputError, match=r"times"):
            times_of(path, times=times)


def write_stream(
    path: Path, frames: int = 30, codec: str = "libx264", shape: int = 1, **options: str
) -> Path:
    """Write a video with PyAV; `shape`: width / height of a pixel."""
    return write_streams(
        path, {"codec": codec, "shape": shape, "images": pictures(frames)}, **options
    )


def write_streams(
    path: Path,
    *streams: dict[str, Any],
    taken_hz: float | None = None,
    created: str = "",
    **options: str,
) -> Path:
    """Write video streams, each a dict of the images and how they are stored."""
    with av.open(str(path), "w", options=options) as file:
        written = []
        if taken_hz:
            file.metadata["com.android.capture.fps"] = str(taken_hz)
        if created:
            file.metadata["creation_time"] = created
        for one in streams:
            codec, fps = one.get("codec", "libx264"), one.get("fps", 10)
            stream = file.add_stream(codec, rate=fps, options=one.get("options", {}))
            (stream.height, stream.width), stream.pix_fmt = (
                one["images"][0].shape[:2],
                one.get("pixels", "yuv420p"),
            )
            stream.sample_aspect_ratio, stream.disposition = (
                Fraction(one.get("shape", 1)),
                one.get("disposition", 1),
            )
            written.append(stream)
        for stream, one in zip(written, streams, strict=True):
            for number, image in enumerate(one["images"]):
                frame = av.VideoFrame.from_ndarray(image, format="rgb24")
                frame.pts, frame.time_base = (
                    one.get("pts", range(999))[number],
                    Fraction(1, one.get("fps", 10)),
                )
                file.mux(stream.encode(frame))
            file.mux(stream.encode())
    return path


@cache
def images_of_a_street() -> list[np.ndarray]:
    return [street.view(pose)[0] for pose in street.arc(120, 0.1, 8.0)]


@pytest.mark.parametrize(
    "how", [{}, {"crf": "28", "g": "15", "preset": "veryfast"}, ".jpg", ".png"], ids=str
)
@pytest.mark.parametrize(
    ("hz", "fps"), [(10, 12), (9.6, 29), (10, 24), (10, 30), (15, 25), (10, 60)]
)
def test_repeats_are_left_out_and_the_others_have_their_times(tmp_path, how, hz, fps):
    """In a conversion to a higher frame rate; the camera loses three images in a row."""
    taken_s = np.delete(np.arange(123) / hz, [60, 61, 62])
    shown = np.searchsorted(taken_s, np.arange(int(122 / hz * fps)) / fps + 1e-9, side="right") - 1
    images = [images_of_a_street()[place] for place in shown]
    if isinstance(how, str):
        path, options = tmp_path / "images", {"fps": fps}
        path.mkdir()
        for number, image in enumerate(images):
            cv2.imwrite(str(path / f"{number}{how}"), image)
    else:
        path, options = (
            write_streams(tmp_path / "a.mp4", {"images": images, "fps": fps, "options": how}),
            {},
        )
    recording = open_recording(path, **options)
    first = np.flatnonzero(np.diff(shown, prepend=-1))
    assert recording.kept.tolist() == first.tolist()
    assert recording.notes[0].startswith(f"{len(shown) - len(first)} of {len(shown)} images repeat")
    true_s = taken_s[: len(first)]
    assert recording.times_s == pytest.approx(
        true_s + np.mean(recording.times_s - true_s), abs=0.6 / fps
    )
    steps_s = durations(np.arange(len(first)), recording.times_s)[1:]
    assert steps_s == pytest.approx(np.diff(true_s), rel=0.06)
    assert [frame.number for frame in recording.frames()] == list(range(len(first)))


UNCHANGED: dict[str, Callable[[list[np.ndarray]], Iterable[np.ndarray]]] = {
    "standing": lambda images: images[:1] * 20,
    "traffic light": lambda images: [*images[:15], *images[15:16] * 20, *images[16:30]],
    "slow": lambda images: pictures(60),
    "night": lambda images: [image // 12 for image in images[:40]],
    "noise": lambda images: (
        np.random.default_rng(0).normal(100, 5, (40, *SIZE, 3)).astype(np.uint8)
    ),
}


@pytest.mark.parametrize("images", UNCHANGED.values(), ids=UNCHANGED)
@pytest.mark.parametrize("fps", [10, 30])
def test_other_unchanged_images_are_no_repeats(tmp_path, images, fps):
    for options in ({}, {"g": "4", "crf": "30"}):
        stream = {"images": list(images(images_of_a_street())), "fps": fps, "options": options}
        recording = open_recording(write_streams(tmp_path / "a.mp4", stream))
        assert (len(recording.kept), recording.notes) == (len(stream["images"]), [])
        np.testing.assert_allclose(
            recording.times_s, np.arange(len(recording.kept)) / fps, atol=1e-3
        )


def test_frames_nearest_to_a_rate(tmp_path):
    for hz, fps, steps in (
        (10, 30, {3}),
        (9.64, 29, {3}),
        (10, 25, {2, 3}),
        (10, 24, {2, 3}),
        (10, 11, {1}),
    ):
        recording = open_recording(write_folder(tmp_path / "images", pictures(60)), fps=fps)
        recording.resample(hz)
        assert {*np.diff(recording.kept).tolist()} == steps
        assert recording.times_s.tolist() == (recording.kept / fps).tolist()
        assert len(recording.times_s) == pytest.approx(
            60 / fps * (fps if steps == {1} else hz), abs=1
        )
        assert len(list(recording.frames())) == len(recording.kept)
    with pytest.raises(InputError, match=r"has 7.0 frames/s, the model was fitted to 10.0"):
        open_recording(tmp_path / "images", fps=7).resample(10)


def test_the_default_stream_is_read_and_no_cover_art(tmp_path):
    small = {"images": pictures(40, (24, 32)), "disposition": 0}
    art = {
        "images": pictures(1),
        "codec": "png",
        "pixels": "rgb24",
        "disposition": Disposition.attached_pic,
    }
    for path, streams in ((tmp_path / "art.mp4", [art]), (tmp_path / "two.mkv", [small])):
        recording = open_recording(write_streams(path, *streams, {"images": pictures(40)}))
        assert (recording.camera.size, len(recording.kept)) == (SIZE, 40)
        used = "video stream 1 (64 x 48 pixels) is used, not 0 (32 x 24 pixels)"
        assert recording.notes == ([used] if streams == [small] else [])


@pytest.mark.parametrize(("skipped", "left"), [(20, 20), (5, 28)])
def test_a_trim_without_encoding_is_complete(tmp_path, skipped, left):
    """By an edit list, which shows images from a time on; or by packets that are missing before a
    key frame.
    """
    write_stream(tmp_path / "a.mp4", 40, "mpeg4")  # a key frame every 12 frames
    options = {"avoid_negative_ts": "disabled"}
    with (
        av.open(str(tmp_path / "a.mp4")) as file,
        av.open(str(tmp_path / "b.mp4"), "w", options=options) as trimmed,
    ):
        stream = trimmed.add_stream_from_template(file.streams.video[0])
        for number, packet in enumerate(file.demux(video=0)):
            if packet.dts is not None and (left == 20 or number >= skipped):
                packet.pts -= skipped * packet.duration
                packet.dts -= skipped * packet.duration
                packet.stream = stream
                trimmed.mux(packet)
    recording = open_recording(tmp_path / "b.mp4")
    assert recording.notes[0].startswith(f"{left} of the file's {40 if left == 20 else 35} frames")
    np.testing.assert_allclose(recording.times_s, np.arange(left) / 10, atol=1e-3)


def replace_in(path: Path, old: bytes, new: bytes) -> None:
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def matrix(a: float, b: float, c: float, d: float) -> bytes:
    """Return a display matrix as MP4 stores it."""
    return struct.pack(
        ">9i", *(round(value * 65536) for value in (a, b, 0, c, d, 0, 0, 0)), 1 << 30
    )


def show(path: Path, *turn: float) -> None:
    """Write a video of upright images, which are shown as a display matrix turns them."""
    replace_in(write_video(path, pictures(2, SIZE[::-1])), matrix(1, 0, 0, 1), matrix(*turn))


def orient(path: Path) -> None:
    """Write a PNG with the EXIF orientation 6, a quarter turn."""
    write_png(path, pictures(1)[0])
    exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif
    replace_in(path, b"\0\0\0\0IEND", chunk + struct.pack(">I", 0) + b"\0\0\0\0IEND")


def test_a_quarter_turn_of_the_display_matrix_is_applied(tmp_path):
    show(tmp_path / "a.mp4", 0, 1, -1, 0)
    (image, *_) = (frame.image for frame in open_recording(tmp_path / "a.mp4").frames())
    # clockwise
    assert np.abs(image.astype(float) - np.rot90(pictures(2, SIZE[::-1])[0], -1)).mean() < 4


def cut(path: Path) -> None:
    """Write a video with its header at the start, and cut its end off."""
    write_stream(path, 40, "mpeg4", movflags="faststart")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def repeated(path: Path) -> None:
    """Two copies of a stream, one after the other: timestamps start again."""
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
    for number, name in enumerate(
        ("12-00-00-front", "12-00-00-back", "12-01-00-front", "12-01-00-back")
    ):
        write_png(path / "thumb.png", pictures(1)[0])
        write_video(path / f"2026-05-01_{name}.mp4", pictures(2 + number))


def two_recordings(path: Path) -> None:
    path.mkdir()
    for number, name in enumerate(("GX010042", "GX020042", "GX010043")):
        write_video(path / f"{name}.mp4", pictures(2 + number))


def stereo(path: Path, axis: int) -> None:
    """Write images of a rendered stereo camera, side by side or one above the other."""
    poses = street.arc(3, 0.1, 8.0)
    right = [
        pose @ np.array([[1, 0, 0, 0.25], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        for pose in poses
    ]
    pairs = [[street.view(pose)[0] for pose in pair] for pair in zip(poses, right, strict=True)]
    write_video(path, [np.concatenate(pair, axis) for pair in pairs])


PLAINLY_WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("mirrored.mp4", lambda path: show(path, -1, 0, 0, 1), "mirrors"),
    ("avchd.mp4", lambda path: write_stream(path, codec="mpeg4", shape=2), "not square"),
    # FFmpeg assumes 25 frames per second
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
    with pytest.raises(InputError, match=problem) as raised:
        list(open_recording(path, fps=None if Path(name).suffix else 10).frames())
    assert raised.value.where.startswith(str(path).encode(errors="replace").decode())


SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {port} RTP/AVP 96\n"
PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{source}\n#EXT-X-ENDLIST\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.sdp", SDP + "a=rtpmap:96 H264/90000\n"),
        ("a.m3u8", PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts")),
        ("b.ffconcat", "ffconcat version 1.0\nfile 'real.mp4'\n"),
        ("a.mov", "RTSPtextrtsp://127.0.0.1:{port}/a\n"),
        (
            "b.mov",
            "\0\0\0\x14ftypqt  \0\0\0\0qt  "
            + PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts"),
        ),
    ],
)
def test_a_playlist_opens_no_socket_and_no_other_file(tmp_path, name, text):
    write_video(tmp_path / "real.mp4", pictures(3))
    with socket.create_server(("127.0.0.1", 0)) as server:
        port, path = server.getsockname()[1], tmp_path / name
        path.write_text(text.format(port=port, folder=tmp_path))
        with pytest.raises(DamagedFile, match="cannot be decoded as a video"):
            list(open_recording(path).frames())
        server.settimeout(0)
        with pytest.raises(BlockingIOError):
            server.accept()


HEAD = "time_s,speed_mps,yaw_rate_radps\n"


def log(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "can.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        HEAD + "1,5,0.1\n1.5,6,-0.2\n",
        HEAD + "1,5,0.1,\n1.5,6,-0.2, ,\n",  # empty fields are no values
        'yaw_rate_radps, note, time_s, speed_mps\n0.1, "a, b", 1, 5\n-0.2,, 1.5, 6\n\n',
        "\ufeffspeed_mps;time_s;yaw_rate_radps\r\n5;1;0.1\r\n6;1.5;-0.2\r\n",
    ],
)
def test_columns_are_found_by_name(tmp_path, text):
    motion = read_logs(RecordingOptions(motion=log(tmp_path, text), offset=10))["motion"]
    np.testing.assert_array_equal(motion.time_s, [11, 11.5])
    np.testing.assert_array_equal(motion.values, [[5, 6], [0.1, -0.2]])


WHEEL = "time_s,wheel_rad\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEAD + "1,5,0\n1.1,1e6,0\n", r"speed_mps is implausible \(limit ±100\): '1e6' in line 3"),
        (HEAD + "1,5,0\n1.3,5,0\n\n1.3,6,0\n", "time_s does not increase .*: 1.3 in line 5"),
        (HEAD + "0,5,0\n2,5,0\n4,5,0\n", "divide milliseconds by 1000"),  # of 500 Hz
        (HEAD + "0,5,0\n0.1,5,\n0.2,5,\n", "yaw_rate_radps has fewer than 2 values"),
        (HEAD + "0,5,0\n100,5,0\n", "divide milliseconds by 1000"),
        (HEAD + "17e17,5,0\n170000000010e7,5,0\n", r"nanoseconds by 1e9; .*: 1.7e\+18 in line 2\."),
        (HEAD + "0,5,0\n1e-4,5,0\n", "median step of 0.0001"),
        (HEAD + "0,5,0\n0,5,5,0\n", "cell 4 has no name in line 1: '0' in line 3.*decimal points"),
        ("time_s;speed_mps;yaw_rate_radps\n0,1;5;0\n", "time_s is not a number: '0,1' in line 2"),
        (
            HEAD + "s,m/s,rad/s\n0,5,0\n",
            "time_s .*'s' in line 2; speed.* 'm/s' in line 2; yaw.* 'rad/s' in line 2",
        ),
        (
            HEAD + "2027-03-31T12:00:00,5,0\n" * 4,
            "time_s is not a number: '2027-03-31T12:00:00' in line 2 and 3 more",
        ),
        (
            HEAD + "0,x,0\n2,999,0\n1,5,9\n",
            "'x' in line 2; speed.*999.*line 3; yaw.*'9' in line 4; time.*1.0 in",
        ),
        (HEAD + '"0,5,0\n', "is not a CSV file"),
        (WHEEL + "1,0.1\n1.1,6.2\n", "wheel_rad is 0 to 2π"),
        (WHEEL + "1,0\n1.1,45\n", "wheel_rad is implausible .*: '45' in line 3"),
        ("frame,wheel_rad\n0,1\n", "has no column time_s"),
        (WHEEL + "\0" * 2, "is in UTF-16. Save it as UTF-8"),
        ("sep=;\n" + WHEEL, "line 1 is Excel's separator, .*Remove line 1: sep=;"),
        (WHEEL, "wheel_rad has fewer than 2 values"),
        ("1\n2\n2\n", "time does not increase .*: 2.0 in line 3"),
        ("0\n100\nx\n", "'x' in line 3; time has a median step .*divide milliseconds by 1000"),
    ],
)
def test_plainly_wrong_logs(tmp_path, text, problem):
    path = log(tmp_path, text)
    files: dict[str, Any] = (
        {"wheel": path, "steering_ratio": 15.0} if "wheel_rad" in text else {"motion": path}
    )
    with pytest.raises(InputError, match=problem):
        read_logs(RecordingOptions(**files)) if "_rad" in text else read_times(path)


def test_interpolation_ends_at_gaps_and_at_the_ends():
    known_s = np.array([0.0, 0.5, 1.0, 1.6, 2.0])
    time_s = np.array([-0.01, -0.0005, 0.25, 1.0, 1.3, 1.6, 1.8, 2.0 + 1e-15, 2.01])
    expected = [np.nan, 0, 0.25, 1, np.nan, 1.6, 1.8, 2, np.nan]
    np.testing.assert_allclose(Log(known_s, known_s[None]).at(time_s), [expected])


def test_two_topics_in_one_log_have_their_own_times(tmp_path):
    """Also one below the other, with a repeated row. The speed has a gap of 0.4 s, the yaw rate one
    of 0.6 s.
    """
    speed = [f"{time_s},{10 * time_s}," for time_s in (0.1, 0.2, 0.3, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2)]
    yaw_rate = [f"{time_s},,{time_s}" for time_s in (0.05, 0.25, 0.35, 0.45, 1.05, 1.15)]
    time_s = np.array([0.05, 0.15, 0.4, 0.45, 0.7, 1.05, 1.1, 1.2])
    expected = np.where([False, True, True, True, False, True, True, False], time_s, np.nan)
    for rows in (
        speed + yaw_rate,
        sorted(speed + yaw_rate, key=lambda row: float(row.split(",")[0])),
    ):
        logs = read_logs(RecordingOptions(motion=log(tmp_path, HEAD + "\n".join([*rows, rows[0]]))))
        np.testing.assert_allclose(logs["motion"].at(time_s), [10 * expected, expected])
        repeated = "can.csv: 1 rows repeat another row and are left out"
        assert [*log_notes(logs, time_s)] == [repeated, "can.csv covers 5 of 8 images"]


@pytest.mark.parametrize(
    ("name", "start_s"), [("a.mkv", 0), ("a.h264", 0), ("images", 0), ("ns", 0), ("times", 1.7e9)]
)
def test_a_log_of_another_time_is_refused_before_images_are_decoded(
    tmp_path, monkeypatch, name, start_s
):
    """30 images at 10 Hz; a tenth of a second in common suffices."""
    path, times = tmp_path / name, tmp_path / "times.txt"
    for number in range(0 if path.suffix else 30):
        write_png(path / f"{10**18 * (name == 'ns') + number * 10**8}.png", pictures(1)[0])
    if path.suffix:
        write_stream(path)
    times.write_text("\n".join(str(start_s + number / 10) for number in range(30)))
    options = (
        {"times": times}
        if name == "times"
        else {"fps": 10.0}
        if name in ("a.h264", "images")
        else {}
    )
    monkeypatch.setattr(recording, "image_size", None)  # which decodes
    text = HEAD + "".join(f"{7200 + number / 10:.1f},5,0\n" for number in range(20))
    span = rf"the images from {start_s:.1f} to {start_s + 2.9:.1f} s\."
    for offset_s, expected in ((0, -7200), (-7202, 2), (-7201.8, None), (-7197.2, None)):
        refused = pytest.raises(InputError, match=rf"{span} .*pass --offset {expected},")
        with refused if expected else pytest.raises(TypeError):
            open_recording(path, **options, motion=log(tmp_path, text), offset=offset_s + start_s)
