"""steer show: a file's datasets and settings, a frame as numbers and as a picture."""

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from pipeline.train import checkpoint
from steer.app import app
from tests.artefacts import write_dataset

DRIVE = "2011_09_26_drive_0001"


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_dataset(tmp_path / "data", {DRIVE: "train"}, frames=5, points=30)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "data"


def show(*arguments: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, ["show", *map(str, arguments)])
    assert result.exit_code == status, result.output
    return result.output


def test_a_file_has_its_datasets_and_settings(data: Path) -> None:
    text = show(data / f"graphs/semantic/{DRIVE}.h5")
    assert "stage: graphs" in text
    assert "xyz: [float32 150 × 3, m, 'rows of a frame: ptr'" in text
    content = json.loads(show(data / f"graphs/semantic/{DRIVE}.h5", "--json"))
    assert (content["frames"], content["settings"]["graphs"]["keep_inter_class"]) == ("5, 0 to 4", 0.2)


def test_a_checkpoint_has_everything_but_weights(data: Path) -> None:
    import torch

    net = {"weight": torch.zeros(2)}
    checkpoint.write(data / "best.pt", {"kind": "steering net", "entry": {"window": 8}, "net": net})
    content = json.loads(show(data / "best.pt", "--json"))
    assert (content["kind"], content["entry"], "net" in content) == ("steering net", {"window": 8}, False)


def test_a_frame_is_printed_and_drawn(data: Path) -> None:
    file = data / f"graphs/semantic/{DRIVE}.h5"
    content = json.loads(show(file, "--frame", 2, "--out", "a.png", "--json"))
    assert (content["frame"], content["edges_knn"]) == (2, 180)
    assert cv2.imread("a.png").std() > 5
    assert "steering_rad:" in show(data / f"labels/{DRIVE}.h5", "--frame", 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.h5"], "nowhere.h5: "),
        (["."], "expected a drive's file (.h5) or a checkpoint (.pt)"),
        (["GRAPHS", "--frame", 77], "has no frame 77"),
        (["GRAPHS", "--frame", 1, "--out", "photo.png"], "photo.png: exists already"),
        (["LABELS", "--frame", 1, "--out", "a.png"], "neither an image nor points"),
    ],
)
def test_wrong_input_is_one_line(data: Path, arguments: list[object], message: str) -> None:
    files = {"GRAPHS": data / f"graphs/semantic/{DRIVE}.h5", "LABELS": data / f"labels/{DRIVE}.h5"}
    Path("photo.png").write_bytes(b"precious")
    text = show(*(files.get(str(argument), argument) for argument in arguments), "--quiet", status=1)
    assert text.startswith("error: ")
    assert message in text
    assert text.count("\n") == 1
    assert Path("photo.png").read_bytes() == b"precious"
