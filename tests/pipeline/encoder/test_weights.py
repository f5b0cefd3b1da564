import hashlib
import socket
import threading
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.encoder import download, perceive, weights
from pipeline.encoder.weights import Source, fill, find, locate, read_published, unnamed

KEY = "encoder.weights"
CONTENT = b"some weights"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file at an address, and an empty folder for what is fetched."""
    monkeypatch.setattr(weights, "CACHE", tmp_path / "weights")
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
    with pytest.raises(InputError, match=rf"has the SHA-256 {SHA256}, not 0{{64}}"):
        find(f"{published.as_uri()}#sha256={'0' * 64}", KEY)
    assert list((tmp_path / "weights").iterdir()) == []


def test_an_address_with_a_general_name_has_a_place_of_its_own(published: Path, tmp_path: Path) -> None:
    place = tmp_path / "weights/net-s/encoder.pth"
    assert find(f"{published.as_uri()}#as=net-s/encoder.pth&sha256={SHA256}", KEY) == (place, SHA256)
    published.unlink()
    assert find(f"{published.as_uri()}#as=net-s/encoder.pth", KEY) == (place, SHA256)


def test_what_cannot_be_had_is_one_line_with_address_and_place(published: Path, tmp_path: Path) -> None:
    place = tmp_path / "weights/net.pth"
    faults = {
        f"http://127.0.0.1:9/net.pth#sha256={SHA256}": rf"{place} is missing and http://127.0.0.1:9/net.pth cannot be",
        "http://127.0.0.1:9/net.pth": rf"curl --create-dirs -L -o {place} http://127.0.0.1:9/net.pth",
        "nowhere.pt": r"nowhere\.pt is missing",
        f"{published}#sha256={'0' * 64}": rf"{SHA256}, not 0{{64}}",
        f"{published}#sha256=abc": "64 hexadecimal digits",
        str(tmp_path): "is a folder",
        f"http://127.0.0.1:9/#sha256={SHA256}": "is a folder",
        f"http://127.0.0.1:9/net.pth#as=../net.pth&sha256={SHA256}": "#as= is where in",
        f"http://127.0.0.1:9/net.pth#as=/net.pth&sha256={SHA256}": "#as= is where in",
        f"{published}#as=net.pth": "#as= is where in",
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
        (OK + b"Content-Length: 99\r\n\r\n" + CONTENT[:-1], "cut short: 11 of 99 bytes"),
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
    with pytest.raises(InputError, match=rf"^{KEY}: .*cannot be fetched \(.*{message}.*put the file there: curl .*$"):
        find(f"{serve(answer)}#sha256={SHA256}", KEY)
    assert list((tmp_path / "weights").iterdir()) == []


def test_a_good_answer_is_kept_and_no_bar_goes_to_a_log(
    published: Path, serve: Callable[[bytes], str], capsys: pytest.CaptureFixture[str]
) -> None:
    path, _ = find(f"{serve(OK + b'Content-Length: 12' + 2 * bytes([13, 10]) + CONTENT)}#sha256={SHA256}", KEY)
    assert path.read_bytes() == CONTENT
    assert capsys.readouterr().err == ""


def test_locating_reads_and_fetches_nothing(published: Path, tmp_path: Path) -> None:
    """Stage check asks where files lie, before any stage spends time."""
    assert locate(f"http://127.0.0.1:9/net.pth#sha256={SHA256}", KEY) == tmp_path / "weights/net.pth"
    assert locate(f"{published}#sha256={'0' * 64}", KEY) == published
    assert not (tmp_path / "weights").exists()


def test_a_silent_server_is_not_waited_for_for_ever(
    published: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(InputError, match="timed out"):
        find(f"http://127.0.0.1:{server.getsockname()[1]}/net.pth#sha256={SHA256}", KEY)
    assert list((tmp_path / "weights").iterdir()) == []


@pytest.mark.parametrize("wrapper", [None, "state_dict", "model"])
def test_published_tensors_are_found_alone_or_beside_settings(tmp_path: Path, wrapper: str | None) -> None:
    state = {"conv.weight": torch.arange(3.0)}
    torch.save({wrapper: state, "meta": {"epoch": 3}} if wrapper else state, tmp_path / "file.pth")
    assert torch.equal(read_published(tmp_path / "file.pth")["conv.weight"], state["conv.weight"])


def test_published_tensors_are_found_between_numbers(tmp_path: Path) -> None:
    """Monodepth2's encoders hold the size of their training images, and whether it was with stereo."""
    state = {"conv.weight": torch.arange(3.0)}
    torch.save(state | {"height": 192, "use_stereo": True}, tmp_path / "file.pth")
    assert read_published(tmp_path / "file.pth").keys() == state.keys()


def test_numbers_as_numpy_1_wrote_them_do_not_hinder(tmp_path: Path) -> None:
    """DINOv2's depth heads hold such, in what their training left beside the tensors."""
    meta = {"abs_rel": np.float64(0.08), "step": np.int64(38400)}
    torch.save({"state_dict": {"conv.weight": torch.arange(3.0)}, "meta": meta}, tmp_path / "new.pth")
    with zipfile.ZipFile(tmp_path / "new.pth") as new, zipfile.ZipFile(tmp_path / "old.pth", "w") as old:
        for item in new.infolist():
            old.writestr(item, new.read(item).replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    assert b"numpy.core.multiarray" in (tmp_path / "old.pth").read_bytes()
    for name in ("new.pth", "old.pth"):
        assert read_published(tmp_path / name)["conv.weight"].tolist() == [0, 1, 2]


def test_published_files_that_are_none_are_refused(tmp_path: Path) -> None:
    class Code:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return print, ("never",)

    contents = {
        "code": Code(),
        "number": 3,
        "tensor": torch.zeros(1),
        "mixed": {"a": torch.zeros(1), "b": "two"},
        "numbered": {0: torch.zeros(1)},
        "wrapped tensor": {"model": torch.zeros(2), "epoch": "third"},
        "empty": {},
    }
    for name, content in contents.items():
        torch.save(content, tmp_path / name)
        with pytest.raises(InputError, match=r"plain state dict|plain values") as caught:
            read_published(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_parts_are_filled_from_their_own_files_and_strictly(tmp_path: Path) -> None:
    torch.manual_seed(0)
    published = UnifiedEncoder("espnetv2-s1").backbone.state_dict()
    torch.save(published, tmp_path / "city.pth")
    model = UnifiedEncoder("espnetv2-s1")
    before = {name: tensor.clone() for name, tensor in model.depth_head.state_dict().items()}
    sources = fill(model, "espnetv2-s1", {"backbone": str(tmp_path / "city.pth")}, "encoder.weights")
    assert sources == [Source("backbone", str(tmp_path / "city.pth"), file_hash(tmp_path / "city.pth"))]
    assert all(torch.equal(tensor, published[name]) for name, tensor in model.backbone.state_dict().items())
    assert all(torch.equal(tensor, before[name]) for name, tensor in model.depth_head.state_dict().items())

    faults = {
        "lacks bu_br_l2.0.bias": {name: t for name, t in published.items() if name != "bu_br_l2.0.bias"},
        "has extra, which the network lacks": published | {"extra": torch.zeros(1)},
        r"has bu_br_l2.0.bias of shape \[3\], the network \[64\]": published | {"bu_br_l2.0.bias": torch.zeros(3)},
    }
    for message, state in faults.items():
        torch.save(state, tmp_path / "bad.pth")
        with pytest.raises(InputError, match=message):
            fill(model, "espnetv2-s1", {"backbone": str(tmp_path / "bad.pth")}, "encoder.weights")
    with pytest.raises(InputError, match=r"Name another file in encoder\.weights; a published file is named by part"):
        fill(model, "espnetv2-s1", str(tmp_path / "city.pth"), "encoder.weights")


def test_a_checkpoint_fills_all_if_it_is_of_the_same_backbone(tmp_path: Path) -> None:
    torch.manual_seed(1)
    fitted, model = UnifiedEncoder("small"), UnifiedEncoder("small")
    perceive.save(tmp_path, "small", fitted.state_dict())
    path = tmp_path / "encoder.pt"
    assert fill(model, "small", str(path), "encoder.weights") == [Source("all", str(path), file_hash(path))]
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), fitted.parameters(), strict=True))
    with pytest.raises(InputError, match=r"'small', expected 'swin-t'\. Name another file in encoder\.weights$"):
        fill(model, "swin-t", str(path), "encoder.weights")


def test_a_part_is_unnamed_if_it_has_something_to_fit_and_no_file() -> None:
    model = UnifiedEncoder("espnetv2-s1")  # its class head has no parameters
    parts = ("backbone", "depth_head", "class_head")
    assert unnamed(model, None, parts) == "backbone"
    assert unnamed(model, {"backbone": "a.pth"}, parts) == "depth_head"
    assert unnamed(model, {"backbone": "a.pth"}, ("backbone", "class_head")) is None
    assert unnamed(model, "encoder.pt", parts) is None
