"""The command steer: quick help, errors as one line, and its verbs show and view."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from pipeline.base import checkpoint
from pipeline.base.checkout import ROOT
from steer.app import app
from tests.artefacts import write_dataset

HEAVY = (
    "torch",
    "cv2",
    "h5py",
    "open3d",
    "matplotlib",
    "scipy",
    "plotly",
    "pykitti",
    "tqdm",
    "pandas",
    "rich",
    "dvc",
)


def test_help_imports_nothing_large():
    code = f"import sys, steer.app; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


DRIVE = "2011_09_26_drive_0001"


@pytest.fixture
def data(tmp_path, monkeypatch) -> Path:
    write_dataset(tmp_path / "data", {DRIVE: "train"}, frames=5, points=30)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "data"


def run(*arguments: object, status: int = 0) -> str:
    result = CliRunner().invoke(app, [*map(str, arguments)])
    assert result.exit_code == status, result.output
    return result.output


def test_a_file_has_its_datasets_and_settings_and_a_checkpoint_everything_but_weights(data):
    import torch

    content = yaml.safe_load(run("show", data / f"graphs/semantic/{DRIVE}.h5"))
    assert content["datasets"]["xyz"][:3] == ["float32 150 × 3", "m", "rows of a frame: ptr"]
    assert content["stage"] == "graphs"
    assert content["settings"]["graphs"]["keep_inter_class"] == 0.2

    trained = {
        "kind": "steering net",
        "drives": [f"2011_09_26_drive_{number:04d}" for number in range(1, 12)],
        "entry": {"window": 8},
        "net": {"weight": torch.zeros(2)},
    }
    checkpoint.write(data / "best.pt", trained)
    content = yaml.safe_load(run("show", data / "best.pt"))
    assert content["kind"] == "steering net"
    assert content["entry"] == {"window": 8}
    assert "net" not in content
    assert content["drives"] == "11: 2011_09_26_drive_0001 to 2011_09_26_drive_0011"


def test_a_frame_is_shown_in_a_page(data):
    path = data / f"graphs/semantic/{DRIVE}.h5"
    for out, number, frame in ((f"out/{DRIVE}.html", 2, []), ("a.html", 4, ["--frame", 4])):
        assert run("view", path, "--out", out, *frame) == f"{out}\n"
        text = Path(out).read_text()
        assert '"name":"edges"' in text
        assert f"<title>{DRIVE}, graphs/semantic, frame {number}</title>" in text
        assert "of 30 points are shown." in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "nowhere.h5"], "nowhere.h5: "),
        (["show", "."], "expected a drive's file (.h5) or a checkpoint (.pt)"),
        (["export", "GRAPHS", "--frame", 77, "a.ply"], "has no frame 77"),
        (["export", "GRAPHS", "--frame", 1, "photo.png"], "expected the name of a PLY or PCD file"),
        (["export", "GRAPHS", "--frame", 1, "photo.ply"], "photo.ply: exists already"),
        (["export", "LABELS", "--frame", 1, "a.ply"], "has no points. Pass a file of point clouds"),
        (["view", "LABELS"], "has no points"),
        (["view", "GRAPHS", "--frame", 77], "has no frame 77"),
    ],
)
def test_wrong_input_is_one_line(data, arguments, message):
    files = {"GRAPHS": data / f"graphs/semantic/{DRIVE}.h5", "LABELS": data / f"labels/{DRIVE}.h5"}
    for name in ("photo.png", "photo.ply"):
        Path(name).write_bytes(b"precious")
    text = run(*(files.get(str(argument), argument) for argument in arguments), status=1)
    assert text.startswith("error: ")
    assert message in text
    assert text.count("\n") == 1
    for name in ("photo.png", "photo.ply"):
        assert Path(name).read_bytes() == b"precious"
    assert not list(Path().glob("a.*"))
