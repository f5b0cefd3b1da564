import hashlib
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pipeline.encoder.download import find

from pipeline.base.errors import InputError
from pipeline.encoder import download

KEY = "encoder.weights"
CONTENT = b"some weights"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file at an address, and an empty folder for what is fetched."""
    monkeypatch.setattr(download, "CACHE", tmp_path / "weights")
    (tmp_path / "net.pth").write_bytes(CONTENT)
    return tmp_path / "net.pth"


def test_a_path_is_taken_with_or_without_its_hash(published: Path) -> None:
    assert find(str(published), KEY) == (published, SHA256)
    assert find(f"{published}#sha256={SHA256.upper()}", KEY) == (published, SHA256)


def test_an_address_is_fetched_once(published: Path, tmp_path: Path) -> None:
    setting = f"{published.as_uri()}#sha256={SHA256}"
    assert find(setting, KEY) == (tmp_path / "weights/net.pth", SHA256)
    published.unlink()
    assert find(setting, KEY) == (tmp_path / "weights/net.pth", SHA256)
    assert [path.name for path in (tmp_path / "weights").iterdir()] == ["net.pth"]


def test_another_file_at_the_address_leaves_nothing(published: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"gave a file of SHA-256 {SHA256}, not 0{{64}}"):
        find(f"{published.as_uri()}#sha256={'0' * 64}", KEY)
    assert list((tmp_path / "weights").iterdir()) == []


def test_what_cannot_be_had_is_one_line_with_address_and_place(published: Path, tmp_path: Path) -> None:
    place = tmp_path / "weights/net.pth"
    faults = {
        f"http://127.0.0.1:9/net.pth#sha256={SHA256}": rf"{place} is missing and http://127.0.0.1:9/net.pth cannot be",
        "http://127.0.0.1:9/net.pth": rf"Put the file there: curl --create-dirs -L -o {place} http://127.0.0.1:9/net.pth",
        "nowhere.pt": r"nowhere\.pt is missing\. Put the file there",
        f"{published}#sha256={'0' * 64}": rf"has the SHA-256 {SHA256}, not 0{{64}}",
        f"{published}#sha256=abc": "64 hexadecimal digits",
        str(tmp_path): "is a folder. Name a file",
        f"http://127.0.0.1:9/#sha256={SHA256}": "is a folder. Name a file",
        f"http://127.0.0.1:port/net.pth#sha256={SHA256}": r"cannot be fetched \(nonnumeric port",
        f"http://[::1/net.pth#sha256={SHA256}": r"cannot be fetched \(Invalid IPv6 URL",
        f"http://127.0.0.1:9/a b.pth#sha256={SHA256}": r"cannot be fetched \(URL can't contain control characters",
    }
    for setting, message in faults.items():
        with pytest.raises(InputError, match=message) as caught:
            find(setting, KEY)
        assert str(caught.value).startswith(KEY)
        assert "\n" not in str(caught.value)


@pytest.fixture
def serve() -> Iterator[Callable[[bytes], str]]:
    """Answers one request with the given bytes, whatever they are; returns the address."""
    threads = []

    def start(answer: bytes) -> str:
        server = socket.create_server(("127.0.0.1", 0))

        def respond() -> None:
            with server, server.accept()[0] as client:
                client.recv(4096)
                client.sendall(answer)

        threads.append(threading.Thread(target=respond))
        threads[-1].start()
        return f"http://127.0.0.1:{server.getsockname()[1]}/net.pth"

    yield start
    for thread in threads:
        thread.join(timeout=10)


OK = b"HTTP/1.1 200 OK\r\n"


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (OK + b"Content-Length: 99\r\n\r\n" + CONTENT, "cut short at 12 of 99 bytes"),
        (OK + b"Content-Length: many\r\n\r\n" + CONTENT, "invalid literal for int"),
        (OK + b"Transfer-Encoding: chunked\r\n\r\n9\r\nsome", "IncompleteRead"),
        (b"no HTTP\r\n\r\n", "no HTTP"),
        (b"", "closed connection"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "404"),
    ],
)
def test_a_bad_answer_is_one_line_and_leaves_nothing(
    published: Path, tmp_path: Path, serve: Callable[[bytes], str], answer: bytes, message: str
) -> None:
    with pytest.raises(InputError, match=rf"^{KEY}: .*cannot be fetched \(.*{message}.*put it there$"):
        find(f"{serve(answer)}#sha256={SHA256}", KEY)
    assert list((tmp_path / "weights").iterdir()) == []


def test_a_good_answer_is_kept_and_no_bar_goes_to_a_log(
    published: Path, serve: Callable[[bytes], str], capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = find(f"{serve(OK + b'Content-Length: 12' + 2 * bytes([13, 10]) + CONTENT)}#sha256={SHA256}", KEY)
    assert path.read_bytes() == CONTENT
    assert capsys.readouterr().err == ""
