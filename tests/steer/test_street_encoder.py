"""steer street: published weights are downloaded, and become the encoder of steer measure."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from models.encoder.street import SOURCES
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.encoder.encoder_file import load_encoder
from steer import api, street_encoder
from steer.app import app

LENS = {"K": "172.9,172.9,154.4,44.95", "fps": 10.0}


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    """Return the user's cache, which steer uses as if there were no checkout."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("steer.street_encoder.is_checkout", lambda: False)
    return tmp_path / "semantic-steering"


def test_the_encoder_is_in_the_checkout_or_in_the_cache(cache, monkeypatch):
    problem = f"{cache}/street: no encoder. Make one for real streets: steer street"
    with pytest.raises(InputError, match=problem):
        api.measure(ROOT / "examples/street", **LENS)
    monkeypatch.undo()
    assert street_encoder.encoder_folder() == ROOT / "weights/street"


@pytest.mark.real
def test_weights_are_downloaded_and_measure_a_street(cache, real_weights, monkeypatch):
    for path, (_, sha256, terms) in SOURCES.items():
        url = (real_weights / path).as_uri()
        monkeypatch.setitem(SOURCES, path, (url, sha256, terms))
    for _ in range(2):  # the second time, nothing is downloaded
        done = CliRunner().invoke(app, ["street"])
        assert done.exit_code == 0, done.output
        *sources, folder = done.output.splitlines()
        assert folder == str(cache / "street")
        assert all("non-commercial" in source for source in sources)
        monkeypatch.setattr("pipeline.encoder.create.hub", None)

    architecture, _ = load_encoder(cache / "street/encoder.pt")
    assert architecture == {"backbone": "street", "sources": sources}
    outcome = api.measure(ROOT / "examples/street", **LENS)
    assert outcome.table["valid"].sum() >= 5
