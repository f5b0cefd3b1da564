"""Weights of encoders: downloads, and files of this project."""

import hashlib
from pathlib import Path

import pytest
import torch

from models.encoder.unified_encoder import build
from pipeline.base.errors import InputError
from pipeline.perception import perceive
from pipeline.perception.create import check_weights, create, fetch
from pipeline.settings.encoder import Encoder

CONTENT = b"some weights"
SHA256 = hashlib.sha256(CONTENT).hexdigest()
PATH = Path("weights/a/net.pth")


@pytest.fixture(autouse=True)
def url(tmp_path, monkeypatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("published.pth").write_bytes(CONTENT)
    return Path("published.pth").resolve().as_uri()


def test_a_file_is_downloaded_once_verified_and_nothing_is_written_to_a_log(url, capsys):
    fetch(PATH, url, SHA256)
    Path("published.pth").unlink()
    fetch(PATH, url, SHA256)
    assert [path.name for path in PATH.parent.iterdir()] == ["net.pth"]
    assert capsys.readouterr().err == ""
    PATH.write_bytes(b"other")
    with pytest.raises(InputError, match=f"SHA-256 is .*, expected {SHA256}"):
        fetch(PATH, url, SHA256)


def test_a_download_with_another_hash_leaves_nothing(url):
    with pytest.raises(InputError, match="cannot download file:") as raised:
        fetch(PATH, url, "0" * 64)
    assert f"curl --create-dirs -L -o {PATH}" in raised.value.fix
    assert list(PATH.parent.iterdir()) == []


def test_an_encoder_of_another_kind_is_refused_and_a_missing_one_named(tmp_path):
    model = build({"backbone": "small"})
    perceive.save(tmp_path, {"backbone": "small"}, model.state_dict())
    fit = {"epochs": 0, "frames": 1, "batch": 1, "learning_rate": 0.1, "seed": 0}
    _, loaded = create(Encoder(backbone="small", weights=Path("encoder.pt"), **fit))
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), loaded.parameters(), strict=True))
    with pytest.raises(InputError, match="backbone is 'small', expected 'street'"):
        create(Encoder(backbone="street", weights=Path("encoder.pt"), **fit))
    with pytest.raises(InputError, match="file is missing") as raised:
        check_weights(Path("weights/street/encoder.pt"))
    assert raised.value.fix == "Make it: make street"
