"""Videos and folders of images: order, frames, times, and files that other programs would show otherwise."""

import os
import socket
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.video.recording import open_recording, read_times
from tests.kitti_drive import write_png
from tests.recordings import SIZE, pictures, write_folder, write_video


def test_images_and_times(tmp_path: Path) -> None:
    images = pictures(5)
    recording = open_recording(write_folder(tmp_path / "a", images), fps=4)
    assert (recording.size, recording.fps, recording.count) == (SIZE, 4, 5)
    frames = list(recording.frames())
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_s for frame in frames] == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_array_equal([frame.image for frame in frames], images)
    untimed = open_recording(tmp_path / "a")
    assert (untimed.fps, np.isnan(next(untimed.frames()).time_s)) == (None, True)


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        (["img_10.png", "img_9.png", "img_100.png"], ["img_9", "img_10", "img_100"]),
        (["b.png", "a.png", "c.JPG", "._a.png"], ["a", "b", "c"]),
    ],
)
def test_order_follows_the_numbers_in_names(tmp_path: Path, names: list[str], ordered: list[str]) -> None:
    for name in names:
        write_png(tmp_path / name, np.full((*SIZE, 3), 80 * ordered.index(Path(name).stem) if name[0] != "." else 9))
    (tmp_path / "notes.txt").write_text("not an image")
    means = [frame.image.mean() for frame in open_recording(tmp_path).frames() if frame.image is not None]
    assert means == [0, 80, 160]


def test_frames_and_times_of_the_container(tmp_path: Path) -> None:
    images = pictures(12)
    video = open_recording(write_video(tmp_path / "a.mp4", images, fps=12.5))
    assert (video.size, video.fps, video.count) == (SIZE, 12.5, 12)
    frames = list(video.frames())
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(12) / 12.5, atol=1e-3)
    assert np.abs(np.array([frame.image for frame in frames], float) - images).mean() < 4
    assert len(list(video.frames())) == 12  # a second pass


def write_stream(path: Path, frames: int = 30, fps: int = 10, codec: str = "libx264") -> Path:
    """Write a video with PyAV."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=fps)
        stream.height, stream.width, stream.pix_fmt = *SIZE, "yuv420p"
        for number, image in enumerate(pictures(frames)):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(number / fps * 1000), Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def test_a_raw_stream_has_no_times(tmp_path: Path) -> None:
    """FFmpeg assumes 25 frames per second."""
    path = write_stream(tmp_path / "a.h264")
    video = open_recording(path)
    assert (video.fps, video.count) == (None, None)
    assert [frame.time_s for frame in open_recording(path, fps=10).frames()][-1] == pytest.approx(2.9)


def replace_in(path: Path, old: bytes, new: bytes) -> None:
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))


def matrix(a: float, b: float, c: float, d: float) -> bytes:
    """Return a display matrix as MP4 stores it."""
    return struct.pack(">9i", *(round(value * 65536) for value in (a, b, 0, c, d, 0, 0, 0)), 1 << 30)


def show(path: Path, *turn: float) -> None:
    replace_in(write_video(path, pictures(2)), matrix(1, 0, 0, 1), matrix(*turn))


def orient(path: Path) -> None:
    """Write a PNG with the EXIF orientation 6, a quarter turn."""
    write_png(path, pictures(1)[0])
    exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    chunk = struct.pack(">I", len(exif)) + b"eXIf" + exif
    replace_in(path, b"\0\0\0\0IEND", chunk + struct.pack(">I", 0) + b"\0\0\0\0IEND")


def test_a_quarter_turn_of_the_display_matrix_is_applied(tmp_path: Path) -> None:
    show(tmp_path / "a.mp4", 0, 1, -1, 0)
    (image, *_) = (frame.image for frame in open_recording(tmp_path / "a.mp4").frames())
    assert np.abs(image.astype(float) - np.rot90(pictures(2)[0], -1)).mean() < 4  # clockwise


def anamorphic(path: Path) -> None:
    """Write a video with pixels 4/3 times as wide as high, as AVCHD has."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mpeg4", rate=10)
        stream.height, stream.width, stream.pix_fmt = *SIZE, "yuv420p"
        stream.sample_aspect_ratio = Fraction(4, 3)
        for image in pictures(2):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def cut(path: Path) -> None:
    """Write a video with its header at the start, and cut its end off."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("mjpeg", rate=10)
        stream.height, stream.width, stream.pix_fmt = *SIZE, "yuvj420p"
        for image in pictures(40):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def twice(path: Path) -> None:
    for kind in ("png", "jpg"):
        write_png(path / f"1.{kind}", pictures(1)[0])


def sizes(path: Path) -> None:
    write_png(path / "1.png", pictures(1)[0])
    write_png(path / "2.png", pictures(1, (40, 64))[0])


PLAINLY_WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("mirrored.mp4", lambda path: show(path, -1, 0, 0, 1), "mirrors"),
    ("turned.mp4", lambda path: show(path, 0.7071, 0.7071, -0.7071, 0.7071), "no multiple of 90 degrees"),
    ("avchd.mp4", anamorphic, "not square"),
    ("cut.mp4", cut, "ends after 19 of 40 frames"),
    ("exif", lambda path: orient(path / "1.png"), "EXIF orientation"),
    ("twice", twice, "several images 1"),
    ("sizes", sizes, "image 1 has 64 x 40 pixels .*64 x 48"),
    ("text.mp4", lambda path: path.write_text("not a video"), "cannot be decoded as a video"),
    ("none.mp4", lambda path: None, "missing"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write", "problem"), PLAINLY_WRONG, ids=[name for name, *_ in PLAINLY_WRONG])
def test_plainly_wrong_recordings(tmp_path: Path, name: str, write: Callable[[Path], object], problem: str) -> None:
    path = tmp_path / name
    write(path)
    with pytest.raises(InputError, match=problem) as raised:
        list(open_recording(path).frames())
    assert raised.value.where.startswith(str(path))


SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {port} RTP/AVP 96\n"
PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{source}\n#EXT-X-ENDLIST\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.sdp", SDP + "a=rtpmap:96 H264/90000\n"),
        ("a.m3u8", PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts")),
        ("b.ffconcat", "ffconcat version 1.0\nfile 'real.mp4'\n"),
        ("a.mov", "RTSPtextrtsp://127.0.0.1:{port}/a\n"),
        ("b.mov", "\0\0\0\x14ftypqt  \0\0\0\0qt  " + PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts")),
    ],
)
def test_a_playlist_opens_no_socket_and_no_other_file(tmp_path: Path, name: str, text: str) -> None:
    write_video(tmp_path / "real.mp4", pictures(3))
    with socket.create_server(("127.0.0.1", 0)) as server:
        port, path = server.getsockname()[1], tmp_path / name
        path.write_text(text.format(port=port, folder=tmp_path))
        with pytest.raises(DamagedFile, match="cannot be decoded as a video"):
            list(open_recording(path).frames())
        server.settimeout(0)
        with pytest.raises(BlockingIOError):
            server.accept()


def external(content: bytes, path: Path) -> bytes:
    """Return an MP4 file whose samples are in the file at `path`: a data reference "alis" replaces "url "."""
    name = os.fsencode(path) + bytes(len(os.fsencode(path)) % 2)
    record = b"alis" + bytes(134) + struct.pack(">hh", 1, 1) + bytes(16)
    record += struct.pack(">HH", 2, len(name)) + name + struct.pack(">hH", -1, 0)
    at = content.index(b"url \0\0\0\1") - 4
    content = content[:at] + struct.pack(">I", len(record) + 4) + record + content[at + 12 :]
    for box in (b"dref", b"dinf", b"minf", b"mdia", b"trak", b"moov"):
        start = content.index(box) - 4
        (size,) = struct.unpack(">I", content[start : start + 4])
        content = content[:start] + struct.pack(">I", size + len(record) - 8) + content[start + 4 :]
    return content


def test_samples_in_another_file_are_not_read(tmp_path: Path) -> None:
    path, real = tmp_path / "a.mp4", write_video(tmp_path / "real.mp4", pictures(3))
    path.write_bytes(external(real.read_bytes(), real))
    with av.open(str(path), options={"enable_drefs": "1"}) as file:  # FFmpeg would read them
        assert len(list(file.decode(video=0))) == 3
    with pytest.raises(DamagedFile, match="no frames"):
        open_recording(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1\n2\n2\n", "from 2 to 2"),
        ("0\n100\n200\n", "divide milliseconds by 1000"),
        ("0\n1e-4\n2e-4\n", "in seconds"),
    ],
)
def test_unusable_times(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "times.txt"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_times(path)
    assert problem in str(raised.value)


def test_names_in_nanoseconds_are_times(tmp_path: Path) -> None:
    stamps = [1479424215880976321, 1479424215930976321, 1479424216040976321]
    for stamp, image in zip(stamps, pictures(3), strict=True):
        write_png(tmp_path / f"{stamp}.png", image)
    recording = open_recording(tmp_path)
    assert [frame.time_s for frame in recording.frames()] == pytest.approx([0, 0.05, 0.16], abs=1e-12)
    assert recording.fps == pytest.approx(2 / 0.16)
    assert [frame.time_s for frame in open_recording(tmp_path, fps=4).frames()] == [0, 0.25, 0.5]


@pytest.mark.parametrize("kind", ["folder", "a.mjpeg"])
def test_times_of_a_file(tmp_path: Path, kind: str) -> None:
    """Also those of a raw stream; another number of them is refused."""
    path, times = tmp_path / kind, tmp_path / "times.txt"
    if kind == "folder":
        write_folder(path, pictures(3))
    else:
        write_video(path, pictures(3), codec="MJPG")
    times.write_text("5\n6\n7.5\n")
    recording = open_recording(path, times=times)
    assert [frame.time_s for frame in recording.frames()] == [5, 6, 7.5]
    assert recording.fps == pytest.approx(0.8)
    for text in ("5\n6\n", "5\n6\n7\n8\n"):
        times.write_text(text)
        with pytest.raises(InputError, match=r"times"):
            list(open_recording(path, times=times).frames())


def test_timestamps_that_do_not_increase_need_a_rate(tmp_path: Path) -> None:
    """Two copies of a stream, one after the other."""
    path = write_stream(tmp_path / "a.ts", codec="mpeg2video")
    path.write_bytes(path.read_bytes() * 2)
    with pytest.raises(DamagedFile, match="do not increase"):
        list(open_recording(path).frames())
    assert len(list(open_recording(path, fps=10).frames())) == 60
