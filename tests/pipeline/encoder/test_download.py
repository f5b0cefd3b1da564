"""Downloads from a server on this machine that is well, or ill in some way."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from pipeline.encoder import download

CONTENT = bytes(range(256)) * 12
SHA256 = hashlib.sha256(CONTENT).hexdigest()


class Answers(BaseHTTPRequestHandler):
    """Answers as the address says, until `over`."""

    over: threading.Event

    def do_GET(self) -> None:
        with suppress(OSError):  # who asked has left
            getattr(self, self.path.strip("/"))()

    def say(self, content: bytes, length: int | None) -> None:
        self.send_response(200)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()
        self.wfile.write(content)

    def right(self) -> None:
        self.say(CONTENT, len(CONTENT))

    def unsaid(self) -> None:
        self.say(CONTENT, None)

    def other(self) -> None:
        self.say(CONTENT[::-1], len(CONTENT))

    def short(self) -> None:
        self.say(CONTENT[:99], len(CONTENT))

    def large(self) -> None:
        self.say(CONTENT, 5000)

    def endless(self) -> None:
        self.say(b"", None)
        while not self.over.is_set():
            self.wfile.write(CONTENT)

    def silent(self) -> None:
        self.say(CONTENT[:99], len(CONTENT))
        self.over.wait()

    def drops(self) -> None:
        self.say(b"", len(CONTENT))
        while not self.over.wait(0.02):
            self.wfile.write(b"x")

    def round(self) -> None:
        self.send_response(302)
        self.send_header("Location", "/round")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[str]:
    Answers.over = threading.Event()
    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as listening:
        thread = threading.Thread(target=listening.serve_forever, args=(0.02,))
        thread.start()
        yield f"http://127.0.0.1:{listening.server_port}"
        Answers.over.set()
        listening.shutdown()
        thread.join()


@pytest.mark.parametrize("name", ["right", "unsaid"])
def test_what_is_right_is_kept_and_no_bar_goes_to_a_log(
    server: str, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "weights/net.pth"
    download.download(f"{server}/{name}", path, SHA256)
    assert path.read_bytes() == CONTENT
    assert [file.name for file in path.parent.iterdir()] == ["net.pth"]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("other", rf"it has the SHA-256 {hashlib.sha256(CONTENT[::-1]).hexdigest()}, not {SHA256}"),
        ("short", "cut short: 99 of 3072 bytes"),
        ("large", "at least 5000 bytes, and 4000 are the most"),
        ("endless", r"at least \d{4,} bytes, and 4000 are the most"),
        ("silent", "timed out"),
        ("drops", r"slower than 1e\+06 kB/s"),
        ("round", "infinite loop"),
    ],
)
def test_what_is_not_is_refused_and_leaves_nothing(
    server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str
) -> None:
    monkeypatch.setattr(download, "MOST_BYTES", 4000)
    if name in ("silent", "drops"):  # others are not to fail on a busy machine
        monkeypatch.setattr(download, "TIMEOUT_S", 1.0)
        monkeypatch.setattr(download, "SLOWEST", 1e9)
    (tmp_path / "net.pth").write_text("an earlier one")
    with pytest.raises((OSError, ValueError, HTTPException), match=message):
        download.download(f"{server}/{name}", tmp_path / "net.pth", SHA256)
    assert [file.name for file in tmp_path.iterdir()] == ["net.pth"]
    assert (tmp_path / "net.pth").read_text() == "an earlier one"
