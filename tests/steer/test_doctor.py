"""steer doctor as a user types it."""

import json
import os
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from pipeline.base import resume
from pipeline.inspect import forecast, stages_due
from steer.app import app
from tests import kitti_drive

DRIVE, OTHER = kitti_drive.DRIVE, "2011_09_26_drive_0002"


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A KITTI raw folder of two whole drives; the user is elsewhere."""
    for drive in (DRIVE, OTHER):
        folder = kitti_drive.write_drive(tmp_path / "kitti", drive, frames=range(kitti_drive.LINES))
        assert folder.is_dir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "kitti"


@pytest.fixture
def project(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project of the user's that reads these drives, and in which no stage is due."""
    here = Path.cwd()
    content = yaml.safe_load((resume.ROOT / "params.yaml").read_text())
    content["ingest"] |= {"source": "kitti", "drives": {"train": [DRIVE], "val": [], "test": [OTHER]}}
    (here / "params.yaml").write_text(yaml.safe_dump(content))
    (here / "dvc.yaml").write_text("stages: {}\n")
    (here / "data").mkdir()
    (here / "data/raw").symlink_to(root)
    monkeypatch.setattr(stages_due, "due", lambda folder: {})
    return here


def say(*words: object, status: int) -> str:
    result = CliRunner().invoke(app, ["doctor", *map(str, words)])
    assert result.exit_code == status, result.output
    return result.output


def test_whole_drives_are_well(root: Path) -> None:
    text = say(root, status=0)
    assert "2 drives, 60 packets" in text
    assert "30               30          cam_to_cam, velo_to_cam  well" in text
    assert text.endswith("all is well\n")
    assert say(root, "--deep", "--quiet", status=0) == ""


def test_a_half_extracted_folder_says_what_to_extract(root: Path) -> None:
    shutil.rmtree(root / f"2011_09_26/{OTHER}_sync/velodyne_points/data")
    (root / f"2011_09_26/{DRIVE}_sync/image_02/data/0000000003.png").write_bytes(b"")
    text = say(root, status=1)
    assert f"  {OTHER}: velodyne_points: nothing was extracted\n" in text
    assert f"  unzip -o {OTHER}_sync.zip '*/velodyne_points/*' -d {root}\n" in text
    told = json.loads(say(root, "--json", status=1))
    assert told["well"] is False
    assert told["drives"][DRIVE]["modalities"]["image_02"]["damaged"] == {"3": "is empty"}
    assert told["commands"][DRIVE] == f"unzip -o {DRIVE}_sync.zip '*/image_02/*' -d {root}"


def test_a_project_is_well_with_its_drives_and_without_what_it_does_not_name(project: Path, root: Path) -> None:
    third = kitti_drive.write_drive(root, "2011_09_26_drive_0005", frames=range(kitti_drive.LINES))
    shutil.rmtree(third / "oxts")
    text = say(status=0)  # data/raw of the project
    assert "2011_09_26_drive_0005, not named in params.yaml: oxts: its folder is missing" in text
    assert "all is well" in text


def test_a_drive_of_params_that_is_not_there(project: Path, root: Path) -> None:
    shutil.rmtree(root / f"2011_09_26/{OTHER}_sync")
    assert f"params.yaml names {OTHER}, which {project}/data/raw lacks: did you mean {DRIVE}?" in say(status=1)
    (project / "data/raw").unlink()
    assert "data/raw is missing, and params.yaml names 2 drives of it. Link it: ln -s" in say(status=1)


def test_stages_that_are_due_with_an_estimate(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    due = {"ingest": "changed deps: params.yaml", "graphs@lidar": "follows ingest"}
    monkeypatch.setattr(stages_due, "due", lambda folder: due)
    text = say(status=1)
    assert "  ingest has to run: changed deps: params.yaml\n" in text
    assert "not needed by a model of params.yaml: graphs@lidar" in text
    assert "estimate, good to a factor of two: " in text
    assert "  1 stage has to run: dvc repro check pictures report\n" in text
    told = json.loads(say("--json", status=1))["project"]
    assert (told["due"], told["not_needed"]) == ({"ingest": due["ingest"]}, ["graphs@lidar"])
    assert told["estimate"]["hours"] > 0


def test_a_disk_that_is_too_small(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages_due, "due", lambda folder: {"ingest": "it has not run here"})
    monkeypatch.setattr(forecast, "free_bytes", lambda folder: 1000)
    assert "has 1.0 kB free, and the run needs some" in say(status=1)


def test_damaged_params_are_one_of_the_things_to_do(project: Path) -> None:
    (project / "params.yaml").write_text("ingest: [")
    text = say(status=1)
    assert "params.yaml:1 is not valid YAML" in text
    content = yaml.safe_load((resume.ROOT / "params.yaml").read_text())
    content["train"]["epochs"] = -1
    (project / "params.yaml").write_text(yaml.safe_dump(content))
    assert "train.epochs = -1" in say(status=1)


@pytest.mark.slow
def test_where_dvc_cannot_say_the_run_is_told_from_the_start(root: Path) -> None:
    here = Path.cwd()
    for name in ("params.yaml", "dvc.yaml"):
        shutil.copyfile(resume.ROOT / name, here / name)
    text = say(root, status=1)  # no `dvc init`
    assert "DVC cannot say which stage has to run" in text
    assert "town has to run" not in text
    assert "  estimate, good to a factor of two: " in text


@pytest.mark.parametrize(
    ("pid", "busy"), [(os.getpid(), True), (2**22 + 1, False), ("x", False)], ids=["it runs", "it ended", "no number"]
)
def test_a_run_in_progress_is_left_alone(
    project: Path, monkeypatch: pytest.MonkeyPatch, pid: object, busy: bool
) -> None:
    def due(folder: Path) -> dict[str, str]:
        assert not busy, "DVC is asked"
        return {}

    monkeypatch.setattr(stages_due, "due", due)
    (project / ".dvc/tmp").mkdir(parents=True)
    writer = {"pid": pid, "cmd": "dvc repro"}
    (project / ".dvc/tmp/rwlock").write_text(json.dumps({"write": {"data/train": writer}}))
    assert ("DVC runs a stage here now (dvc repro)" in say(status=0)) == busy


def test_errors_are_one_line(root: Path) -> None:
    for words, said in (
        ([], "there is no project here"),
        ([root / "nowhere"], "nowhere holds no drives"),
        (
            [root.parent],
            f"holds no drives: KITTI raw's layout is <date>/<date>_drive_NNNN_sync. {root} does: give that",
        ),
    ):
        text = say(*words, status=1)
        assert text.startswith("error: ")
        assert said in text
        assert text.count("\n") == 1


def test_one_drive_or_one_date(root: Path) -> None:
    assert "1 drives" not in say(root / f"2011_09_26/{DRIVE}_sync", status=0)
    assert "2 drives" in say(root / "2011_09_26", status=0)


@pytest.mark.real
@pytest.mark.slow
def test_real_drives(root: Path, real_kitti: Path, real_half: Path) -> None:
    assert say(real_half, "--deep", status=0).endswith("all is well\n")
    told = json.loads(say(real_kitti, "--json", status=1))
    assert list(told["commands"]) == ["2011_09_26_drive_0001"]
    assert "image_02 lacks 107 of 108 frames: 0-4, 6-107" in told["to_do"][0]
