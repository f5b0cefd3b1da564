"""Video files: streams, edit lists, display matrices, and no other file or socket."""

import socket

import av
import numpy as np
import pytest
from av.stream import Disposition

from pipeline.base.errors import DamagedFile
from tests.footage.videos import (
    convert,
    images_of,
    read,
    show,
    times_of,
    write_stream,
    write_streams,
)
from tests.kitti_drive import SIZE, pictures, write_video


def test_the_default_stream_is_read_and_no_cover(tmp_path):
    small = {"images": pictures(40, (24, 32)), "disposition": 0}
    art = {
        "images": pictures(1),
        "codec": "png",
        "pixels": "rgb24",
        "disposition": Disposition.attached_pic,
    }
    for name, other in (("two.mkv", small), ("art.mp4", art)):
        path = write_streams(tmp_path / name, other, {"images": pictures(40)})
        convert(tmp_path / f"{name}.drives", path)
        assert images_of(read(tmp_path / f"{name}.drives")).shape == (40, *SIZE, 3)


@pytest.mark.parametrize(("skipped", "left"), [(20, 20), (5, 28)])
def test_a_trim_without_encoding_is_complete(tmp_path, skipped, left):
    """An edit list shows images from a time on, or packets are missing before a key frame."""
    write_stream(tmp_path / "a.mp4", 40, "mpeg4")  # a key frame every 12 frames
    by_edit_list = left == 20
    options = {"avoid_negative_ts": "disabled"}
    with (
        av.open(str(tmp_path / "a.mp4")) as file,
        av.open(str(tmp_path / "b.mp4"), "w", options=options) as trimmed,
    ):
        stream = trimmed.add_stream_from_template(file.streams.video[0])
        for number, packet in enumerate(file.demux(video=0)):
            if packet.dts is not None and (by_edit_list or number >= skipped):
                packet.pts -= skipped * packet.duration
                packet.dts -= skipped * packet.duration
                packet.stream = stream
                trimmed.mux(packet)
    convert(tmp_path / "drives", tmp_path / "b.mp4")
    np.testing.assert_allclose(times_of(read(tmp_path / "drives")), np.arange(left) / 10, atol=1e-3)


def test_a_quarter_turn_of_the_display_matrix_is_applied(tmp_path):
    show(tmp_path / "a.mp4", 0, 1, -1, 0)
    convert(tmp_path / "drives", tmp_path / "a.mp4")
    clockwise = np.rot90(pictures(2, SIZE[::-1])[0], -1)
    assert np.abs(images_of(read(tmp_path / "drives"))[0].astype(float) - clockwise).mean() < 4


SDP = "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {port} RTP/AVP 96\n"
PLAYLIST = (
    "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nhttp://127.0.0.1:{port}/a.ts\n#EXT-X-ENDLIST\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.sdp", SDP + "a=rtpmap:96 H264/90000\n"),
        ("a.m3u8", PLAYLIST),
        ("b.ffconcat", "ffconcat version 1.0\nfile 'real.mp4'\n"),
        ("a.mov", "RTSPtextrtsp://127.0.0.1:{port}/a\n"),
        ("b.mov", "\0\0\0\x14ftypqt  \0\0\0\0qt  " + PLAYLIST),
    ],
)
def test_a_playlist_opens_no_socket_and_no_other_file(tmp_path, name, text):
    write_video(tmp_path / "real.mp4", pictures(3))
    path = tmp_path / name
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        path.write_text(text.format(port=port))
        with pytest.raises(DamagedFile, match="cannot be decoded as a video"):
            convert(tmp_path / "drives", path)
        server.settimeout(0)
        with pytest.raises(BlockingIOError):
            server.accept()
