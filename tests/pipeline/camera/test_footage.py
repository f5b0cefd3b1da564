"""Folders of images: order, formats, sizes. Videos: frames, times, and faults of files."""

import os
import socket
import struct
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pipeline.base.errors import DamagedFile, InputError
from pipeline.camera.footage import ImageFolder, Video, open_footage, read_times
from tests.footage import SIZE, pictures, write_folder, write_video
from tests.kitti_drive import write_png


def test_images_and_times(tmp_path: Path) -> None:
    images = pictures(5)
    folder = open_footage(write_folder(tmp_path / "a", images), fps=4)
    assert (folder.size, folder.fps, folder.count) == (SIZE, pytest.approx(4), 5)
    frames = list(folder.frames())
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_s for frame in frames] == [0, 0.25, 0.5, 0.75, 1]
    np.testing.assert_array_equal([frame.image for frame in frames], images)
    assert np.isnan(next(open_footage(tmp_path / "a").frames()).time_s)


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        (["img_10.png", "img_9.png", "img_100.png"], ["img_9", "img_10", "img_100"]),
        (["b.png", "a.png", "c.JPG"], ["a", "b", "c"]),
        (["a-2_1.png", "a-1_2.png", "a-1_10.png"], ["a-1_2", "a-1_10", "a-2_1"]),
        (["01.png", "1.png", "0.png"], ["0", "01", "1"]),
    ],
)
def test_order_follows_the_numbers_in_names(tmp_path: Path, names: list[str], ordered: list[str]) -> None:
    for name in names:
        write_png(tmp_path / name, pictures(1)[0])
    (tmp_path / "notes.txt").write_text("not an image")
    folder = open_footage(tmp_path)
    assert isinstance(folder, ImageFolder)
    assert [file.stem for file in folder.files] == ordered


def test_names_that_are_not_utf8(tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff")
    write_png(tmp_path / "a.png", pictures(1)[0])
    (tmp_path / "a.png").rename(tmp_path / f"{name}.png")
    assert len(list(open_footage(tmp_path).frames())) == 1
    video = write_video(tmp_path / "a.mp4", pictures(2)).rename(tmp_path / f"{name}.mp4")
    assert len(list(open_footage(video).frames())) == 2


@pytest.mark.parametrize(
    ("images", "kind", "problem"),
    [
        ([], InputError, "no images"),
        ([pictures(1)[0], pictures(1, (40, 64))[0]], InputError, "64 x 40 pixels .*64 x 48"),
        ([np.zeros(SIZE, np.uint16)], DamagedFile, "uint16"),
        ([np.zeros((1, 1, 3), np.uint8)], InputError, "1 x 1 pixels"),
    ],
)
def test_unusable_images(tmp_path: Path, images: list[np.ndarray], kind: type, problem: str) -> None:
    for number, image in enumerate(images):
        write_png(tmp_path / f"{number}.png", image)
    with pytest.raises(kind, match=problem) as raised:
        list(open_footage(tmp_path).frames())
    assert raised.value.where.startswith(str(tmp_path))


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
def test_frames_and_times_of_the_container(tmp_path: Path, kind: str) -> None:
    images = pictures(12)
    video = open_footage(write_video(tmp_path / f"a.{kind}", images, fps=12.5))
    assert isinstance(video, Video)
    assert (video.size, video.fps, video.count) == (SIZE, 12.5, 12)
    frames = list(video.frames())
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(12) / 12.5, atol=1e-3)
    assert video.untimed_from is None
    assert np.abs(np.array([frame.image for frame in frames], float) - images).mean() < 4
    assert len(list(video.frames())) == 12  # a second pass


def test_changing_size_is_refused(tmp_path: Path) -> None:
    """A stream of JPEGs, two of which have another size."""
    images = [*pictures(3), *pictures(2, (40, 64))]
    path = tmp_path / "a.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", image)[1].tobytes() for image in images))
    frames = open_footage(path).frames()
    assert [next(frames).number for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputError, match=r"frame 3 has 64 x 40 pixels .*64 x 48"):
        next(frames)


@pytest.mark.parametrize("kind", ["avi", "mkv"])
def test_truncated_video_yields_what_it_has_and_fails(tmp_path: Path, kind: str) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (40, *SIZE, 3), np.uint8)
    path = write_video(tmp_path / f"a.{kind}", noise, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames, numbers = open_footage(path).frames(), list[int]()
    with pytest.raises(DamagedFile) as raised:
        numbers.extend(frame.number for frame in frames)
    assert raised.value.where == str(path)
    assert 5 < len(numbers) < 35


def write_stream(path: Path, frames: int = 30, fps: int = 10, start_s: float = 0.0, codec: str = "libx264") -> Path:
    """Write a video with PyAV, whose first frame is at `start_s`."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=fps)
        stream.height, stream.width, stream.pix_fmt = *SIZE, "yuv420p"
        for number, image in enumerate(pictures(frames)):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round((number / fps + start_s) * 1000), Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path


def test_a_raw_stream_has_no_times(tmp_path: Path) -> None:
    """FFmpeg assumes 25 frames per second."""
    path = write_stream(tmp_path / "a.h264")
    video = open_footage(path)
    assert (video.has_times, video.fps, video.count) == (False, None, None)
    assert np.isnan([frame.time_s for frame in video.frames()]).all()
    assert [frame.time_s for frame in open_footage(path, fps=10).frames()][-1] == pytest.approx(2.9)


@pytest.mark.parametrize("start_s", [0.0, 5.0])
def test_the_duration_counts_from_the_first_frame(tmp_path: Path, start_s: float) -> None:
    path = write_stream(tmp_path / "a.mkv", start_s=start_s)
    video = open_footage(path)
    assert [frame.time_s for frame in video.frames()] == pytest.approx(np.arange(30) / 10, abs=2e-3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(DamagedFile):
        list(open_footage(path).frames())


def test_a_video_is_opened_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, demuxed, path_open, av_open = [], [], Path.open, av.open
    monkeypatch.setattr(Path, "open", lambda path, *args: opened.append(path) or path_open(path, *args))
    monkeypatch.setattr(av, "open", lambda *args, **options: demuxed.append(args) or av_open(*args, **options))
    video = open_footage(write_video(tmp_path / "a.mp4", pictures(12)))
    assert [frame.number for frame in islice(video.frames(), 5)] == [*range(5)]  # as the search for the horizon
    assert (len(opened), len(demuxed)) == (1, 1)
    assert [frame.number for frame in video.frames()] == [*range(12)]  # rewinds the open file
    assert (len(opened), len(demuxed)) == (1, 2)


SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {port} RTP/AVP 96\n"
PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{source}\n#EXT-X-ENDLIST\n"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.mp4", SDP + "a=rtpmap:96 H264/90000\n"),
        ("a.sdp", SDP + "a=rtpmap:96 H264/90000\n"),
        ("a.m3u8", PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts")),
        ("b.m3u8", PLAYLIST.replace("{source}", "{folder}/real.mp4")),
        ("a.ffconcat", "ffconcat version 1.0\nfile 'http://127.0.0.1:{port}/a.mp4'\n"),
        ("b.ffconcat", "ffconcat version 1.0\nfile 'real.mp4'\n"),
        ("a.mov", "RTSPtextrtsp://127.0.0.1:{port}/a\n"),
        ("b.mov", "\0\0\0\x14ftypqt  \0\0\0\0qt  " + PLAYLIST.replace("{source}", "http://127.0.0.1:{port}/a.ts")),
        ("a.mpd", "<MPD><Period><BaseURL>http://127.0.0.1:{port}/a.mp4</BaseURL></Period></MPD>"),
    ],
)
def test_texts_that_name_other_sources_are_refused(tmp_path: Path, name: str, text: str) -> None:
    write_video(tmp_path / "real.mp4", pictures(3))
    with socket.create_server(("127.0.0.1", 0)) as server:
        port, path = server.getsockname()[1], tmp_path / name
        path.write_text(text.format(port=port, folder=tmp_path))
        with pytest.raises(DamagedFile, match="cannot be opened as a video") as raised:
            list(open_footage(path).frames())
        assert "\n" not in str(raised.value)
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
        open_footage(path)


@pytest.mark.parametrize(
    "text", ["", "1\n12:30\n", "inf\n", "1\n2\n2\n", "0\n1e12\n", "-62e9\n1\n", "1\n1.000000000001\n"]
)
def test_unusable_times(tmp_path: Path, text: str) -> None:
    path = tmp_path / "times.txt"
    path.write_text(text)
    with pytest.raises(InputError) as raised:
        read_times(path)
    assert raised.value.where == str(path)
    with pytest.raises(InputError, match="missing"):
        read_times(tmp_path / "nothing.txt")


def test_names_in_nanoseconds_are_times(tmp_path: Path) -> None:
    stamps = [1479424215880976321, 1479424215930976321, 1479424216040976321]
    for stamp, image in zip(stamps, pictures(3), strict=True):
        write_png(tmp_path / f"{stamp}.png", image)
    folder = open_footage(tmp_path)
    assert [frame.time_s for frame in folder.frames()] == pytest.approx([0, 0.05, 0.16], abs=1e-12)
    assert folder.fps == pytest.approx(2 / 0.16)
    assert [frame.time_s for frame in open_footage(tmp_path, fps=4).frames()] == [0, 0.25, 0.5]


@pytest.mark.parametrize("kind", ["folder", "a.mp4", "a.mjpeg"])
def test_times_of_a_file(tmp_path: Path, kind: str) -> None:
    """Also those of a raw stream; another number of them is refused."""
    source, path = tmp_path / kind, tmp_path / "times.txt"
    if kind == "folder":
        write_folder(source, pictures(3))
    else:
        write_video(source, pictures(3), codec="MJPG" if kind == "a.mjpeg" else "mp4v")
    path.write_text("5\n6\n7.5\n")
    footage = open_footage(source, times=path)
    assert [frame.time_s for frame in footage.frames()] == [5, 6, 7.5]
    assert (footage.has_times, footage.fps) == (True, pytest.approx(0.8))
    for text in ("5\n6\n", "5\n6\n7\n8\n"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"has 3 images, but --times has [24] lines"):
            list(open_footage(source, times=path).frames())
    with pytest.raises(InputError, match="got two"):
        open_footage(source, 4.0, path)
