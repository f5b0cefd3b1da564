"""steer show as a user types it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from steer.app import app
from tests import kitti_drive
from tests.artefacts import write_dataset

pytestmark = pytest.mark.slow  # a process of its own reads
DRIVE = "2011_09_26_drive_0001"


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    write_dataset(tmp_path / "data", {DRIVE: "train", "2011_09_26_drive_0002": "test"}, frames=5, points=30)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "data"


def say(*words: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, ["show", *map(str, words)])
    assert result.exit_code == status, result.output
    return result.output


def test_a_file_is_told_and_its_frame_drawn_where_the_user_is(data: Path) -> None:
    text = say(data / f"graphs/semantic/{DRIVE}.h5", "--frame", 3, "--ply", "frame.ply")
    assert "stage graphs, drive 2011_09_26_drive_0001: 5 frames, 0 to 4" in text
    assert "not known stage by stage: no dvc.lock" in text
    assert "points: frame.ply, 30 in the camera frame" in text
    picture = cv2.imread(f"{DRIVE}-frame-3.png")
    assert picture is not None
    assert picture.std() > 5
    assert sorted(path.name for path in Path().iterdir()) == [f"{DRIVE}-frame-3.png", "frame.ply"]


def test_json_holds_the_same_and_nothing_else_is_said(data: Path) -> None:
    told = json.loads(say(data / f"graphs/semantic/{DRIVE}.h5", "--json", "--frame", 2, "--out", "a.png"))
    assert told["frames"]["count"] == 5
    assert told["shown"]["picture"] == "a.png"
    assert told["shown"]["values"]["edges_knn"] == 180
    assert told["provenance"]["stages"] == []
    assert say(data / "graphs/semantic", "--quiet") == ""


def test_numbers_alone_have_no_picture(data: Path) -> None:
    text = say(data / f"labels/{DRIVE}.h5", "--frame", 2)
    assert "speed_mps 8" in text
    assert "picture: none" in text
    assert not list(Path().iterdir())
    assert "nothing to draw" in say(data / f"labels/{DRIVE}.h5", "--out", "a.png", status=1)


def test_a_raw_drive(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path / "raw", frames=range(3))
    text = say(folder, "--frame", 1, "--out", tmp_path / "street.png")
    assert "image_02         3      0 to 2" in text
    assert "where it came from" not in text
    assert cv2.imread(str(tmp_path / "street.png")) is not None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere is missing"),
        (["FILE", "--frame", 77], "has no frame 77: it has 0 to 4"),
        (["FILE", "--view"], "there is no display here"),
        (["FILE", "--frame", 1, "--out", "a.gif"], "no name of a PNG"),
        (["FILE", "--ply", "a.obj"], "no name of a PLY"),
        (["FOLDER", "--frame", 1], "several drives or none"),
    ],
)
def test_errors_are_one_line(data: Path, monkeypatch: pytest.MonkeyPatch, words: list[object], said: str) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    places = {"FILE": data / f"graphs/semantic/{DRIVE}.h5", "FOLDER": data / "graphs/semantic"}
    text = say(*(places.get(str(word), word) for word in words), "--quiet", status=1)
    assert text.startswith("error: ")
    assert said in text
    assert text.count("\n") == 1


def test_flipped_bits_end_in_one_line_or_in_what_is_left(data: Path) -> None:
    path = data / f"graphs/semantic/{DRIVE}.h5"
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(30):
        damaged = bytearray(content)
        for place in rng.integers(0, min(len(content), 4096), 8):
            damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        result = CliRunner().invoke(app, ["show", str(path), "--quiet"])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        assert result.output.count("\n") <= 1
