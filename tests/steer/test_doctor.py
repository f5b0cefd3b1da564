"""steer doctor: raw drives and due stages."""

import json
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from pipeline.base import resume
from pipeline.show import project as checks
from steer.app import app
from tests import kitti_drive

DRIVE, OTHER = kitti_drive.DRIVE, "2011_09_26_drive_0002"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A KITTI raw folder with two complete drives; the working folder is elsewhere."""
    for drive in (DRIVE, OTHER):
        kitti_drive.write_drive(tmp_path / "kitti", drive, frames=range(kitti_drive.LINES))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "kitti"


@pytest.fixture
def project(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project that reads these drives, in which no stage is due."""
    here = Path.cwd()
    content = yaml.safe_load((resume.ROOT / "params.yaml").read_text())
    content["ingest"] |= {"source": "kitti", "drives": {"train": [DRIVE], "val": [], "test": [OTHER]}}
    (here / "params.yaml").write_text(yaml.safe_dump(content))
    (here / "dvc.yaml").write_text("stages: {}\n")
    (here / "data").mkdir()
    (here / "data/raw").symlink_to(root)
    set_due(monkeypatch, {})
    return here


def set_due(monkeypatch: pytest.MonkeyPatch, stages: dict[str, str]) -> None:
    def due_stages(folder: Path) -> dict[str, str]:
        return stages

    monkeypatch.setattr(checks, "due_stages", due_stages)


def doctor(*arguments: object, status: int) -> str:
    result = CliRunner().invoke(app, ["doctor", *map(str, arguments)])
    assert result.exit_code == status, result.output
    return result.output


def test_complete_drives(root: Path) -> None:
    text = doctor(root, status=0)
    row = [DRIVE, "30", "30", "30", "cam_to_cam,", "velo_to_cam", "0"]
    assert row in [line.split() for line in text.splitlines()]
    assert text.endswith("no problems found\n")
    assert doctor(root, "--deep", "--quiet", status=0) == ""


def test_partly_extracted_drives_and_the_command_that_extracts_them(root: Path) -> None:
    shutil.rmtree(root / f"2011_09_26/{OTHER}_sync/velodyne_points/data")
    (root / f"2011_09_26/{DRIVE}_sync/image_02/data/0000000003.png").write_bytes(b"")
    text = doctor(root, status=1)
    assert f"  {OTHER}: velodyne_points: no files" in text
    assert f"  unzip -o {OTHER}_sync.zip '*/velodyne_points/*' -d {root}\n" in text
    content = json.loads(doctor(root, "--json", status=1))
    assert content["problems"][0] == f"{DRIVE}: image_02: frame 3 is empty"
    assert content["commands"][0] == f"unzip -o {DRIVE}_sync.zip '*/image_02/*' -d {root}"


def test_an_imported_drive(project: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It needs no oxts unless its labels do, has no archive, and may be a part of a recording."""
    name = "2027_03_31_drive_0002"
    drive = kitti_drive.write_drive(root, name, frames=range(10, 20), lidar=False)
    (drive / "oxts/timestamps.txt").rename(drive / "image_02/timestamps.txt")
    shutil.rmtree(drive / "oxts")
    assert f"{name}, not" not in doctor(status=0)
    with monkeypatch.context() as context:
        context.chdir(root)
        assert "no problems" in doctor(drive, status=0)
    params = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(params.replace(OTHER, name))
    assert f"{name}: no oxts, which labels.source: oxts needs" in doctor(status=1)
    (project / "params.yaml").write_text(params.replace(OTHER, name).replace("source: oxts", "source: visual"))
    assert "no problems" in doctor(status=0)
    (drive / "image_02/data/0000000023.png").write_bytes(b"")
    text = doctor(status=1)
    assert "frame 23 is empty" in text
    assert "unzip" not in text
    assert f"steer import SOURCE --drive {name} --force" in text


def test_drives_of_params_that_are_missing(project: Path, root: Path) -> None:
    shutil.rmtree(root / f"2011_09_26/{OTHER}_sync")
    text = doctor(status=1)
    assert f"missing in {project}/data/raw: {OTHER} (did you mean {DRIVE}?)" in text
    (project / "data/raw").unlink()
    assert "ln -s" in doctor(status=1)


def test_due_stages(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are no problem, and a stage that has never run needs no reason."""
    set_due(
        monkeypatch, {"ingest": "changed deps: params.yaml", "report": checks.NOT_RUN, "graphs@lidar": "needs ingest"}
    )
    text = doctor(status=0)
    assert ["ingest", "changed", "deps:", "params.yaml"] in [line.split() for line in text.splitlines()]
    assert "stages that have to run: 2. Run: dvc repro" in text
    assert text.endswith("no problems found\n")
    found = json.loads(doctor("--json", status=0))["project"]
    assert (set(found["due"]), found["unused"]) == ({"ingest", "report"}, ["graphs@lidar"])
    set_due(monkeypatch, {"ingest": checks.NOT_RUN, "report": checks.NOT_RUN})
    assert checks.NOT_RUN not in doctor(status=0)
