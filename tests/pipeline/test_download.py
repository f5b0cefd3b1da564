import hashlib
from pathlib import Path

import pytest

from pipeline import download
from pipeline.download import find
from pipeline.errors import InputError

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
        "http://127.0.0.1:9/net.pth": rf"Put the file there: curl -L -o {place} http://127.0.0.1:9/net.pth",
        "nowhere.pt": r"nowhere\.pt is missing\. Put the file there",
        f"{published}#sha256={'0' * 64}": rf"has the SHA-256 {SHA256}, not 0{{64}}",
        f"{published}#sha256=abc": "64 hexadecimal digits",
    }
    for setting, message in faults.items():
        with pytest.raises(InputError, match=message) as caught:
            find(setting, KEY)
        assert str(caught.value).startswith(KEY)
        assert "\n" not in str(caught.value)
