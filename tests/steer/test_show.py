"""steer show: output, pictures, and errors."""

import json
from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

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


def test_file_with_its_datasets_and_params(data: Path) -> None:
    text = show(data / f"graphs/semantic/{DRIVE}.h5")
    rows = [line.split() for line in text.splitlines()]
    assert ["stage", "graphs"] in rows
    assert ["xyz", "150", "×", "3", "float32", "m"] in [row[:6] for row in rows]
    assert "keep_inter_class: 0.2" in text


def test_frame_is_drawn_and_printed_alone(data: Path) -> None:
    text = show(data / f"graphs/semantic/{DRIVE}.h5", "--frame", 3)
    assert text.splitlines()[1].split() == ["frame", "3"]
    picture = cv2.imread(f"{DRIVE}-frame-3.png")
    assert picture is not None
    assert picture.std() > 5
    show(data / f"labels/{DRIVE}.h5", "--frame", 2)  # numbers only
    assert [path.name for path in Path().iterdir()] == [f"{DRIVE}-frame-3.png"]


def test_json_and_quiet(data: Path) -> None:
    content = json.loads(show(data / f"graphs/semantic/{DRIVE}.h5", "--json"))
    assert (content["frames"], content["stage"]) == (5, "graphs")
    content = json.loads(show(data / f"graphs/semantic/{DRIVE}.h5", "--json", "--frame", 2, "--out", "a.png"))
    assert (content["picture"], content["edges_knn"]) == ("a.png", 180)
    assert show(data, "--quiet") == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: "),
        (["FILE", "--frame", 77], "has no frame 77"),
        (["FILE", "--frame", 1, "--out", "a.gif"], "--out: "),
        (["FILE", "--frame", 1, "--out", "folder.png"], "folder.png: steer did not write"),
        (["FILE", "--frame", 1, "--out", "photo.png"], "photo.png: steer did not write"),
    ],
)
def test_errors_are_one_line(data: Path, arguments: list[object], message: str) -> None:
    file = data / f"graphs/semantic/{DRIVE}.h5"
    Path("folder.png").mkdir()
    (Path("folder.png") / "precious").touch()
    Path("photo.png").write_bytes(b"precious")
    text = show(*(file if argument == "FILE" else argument for argument in arguments), "--quiet", status=1)
    assert text.startswith("error: ")
    assert message in text
    assert Path("folder.png/precious").exists()
    assert Path("photo.png").read_bytes() == b"precious"
    assert text.count("\n") == 1
