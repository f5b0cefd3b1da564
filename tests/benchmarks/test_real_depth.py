"""The experiment at a small part of its size, on noise in KITTI's layout."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from benchmarks import real_depth
from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.base.errors import InputError
from pipeline.kitti.raw import find_drives
from pipeline.sections.preset import find
from stages import encoder
from tests.kitti_drive import SIZE, write_drive

FRAMES = 3


@pytest.fixture
def roots(tmp_path: Path) -> tuple[Path, Path]:
    """The two folders of real drives; 0039 has neither colour nor scans."""
    half, kitti = tmp_path / "half", tmp_path / "kitti"
    for drive in real_depth.DRIVES[:-1]:
        grey = drive.endswith("_0039")
        write_drive(half, drive, range(FRAMES), camera=0 if grey else 2, lidar=not grey)
    write_drive(half, real_depth.DRIVES[0], range(FRAMES))  # writes the calibration of both cameras again
    write_drive(kitti, "2011_09_26_drive_0052", range(FRAMES))
    return half, kitti


def test_each_size_has_its_own_calibration(roots: tuple[Path, Path], tmp_path: Path) -> None:
    half, kitti = roots
    (kitti / "2011_09_26/calib_cam_to_cam.txt").write_text("of the full size")
    real_depth.lay_out(half, kitti, tmp_path / "raw")
    drives = find_drives(tmp_path / "raw", real_depth.DRIVES)
    full = [drive for drive, raw in drives.items() if "full" in (raw.calibration / "calib_cam_to_cam.txt").read_text()]
    assert full == [real_depth.FULL_SIZE]
    assert [len(raw.oxts) for raw in drives.values()] == [FRAMES] * 5


@pytest.mark.slow
def test_each_drive_has_its_line(
    roots: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEER_WORKERS", "1")
    torch.manual_seed(3)
    published = UnifiedEncoder("espnetv2").backbone.state_dict()
    published["bu_dec_l4.merge_layer.3.weight"] *= 30  # noise that sees many classes
    torch.save(published, tmp_path / "city.pth")
    changes = yaml.safe_load(find("real").read_text())
    changes["ingest"]["image_size"] = list(SIZE)
    teacher = {"backbone": "espnetv2", "weights": {"backbone": str(tmp_path / "city.pth")}}
    changes["encoder"] |= {"backbone": "small", "weights": None, "frozen": False, "teacher": teacher}
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(changes))
    taught, fit = [], encoder.main

    def noted(ingest: Path, out: Path, params: Path) -> Path:
        taught.append(json.loads((fit(ingest, out, params) / "config.json").read_text())["frames_per_drive"])
        return out

    monkeypatch.setattr(encoder, "main", noted)
    real_depth.main(*roots, ["0039", "0052"], str(tmp_path / "small.yaml"), frames=4, epochs=1)
    printed = capsys.readouterr()
    assert "class_head by the teacher's classes" in printed.err
    left_out = [set(real_depth.DRIVES) - frames.keys() for frames in taught]  # of both networks
    assert left_out == [{"2011_09_26_drive_0039"}] * 2 + [{real_depth.FULL_SIZE}] * 2
    depth, cls = (
        [line.strip("| ").split(" | ") for line in part.splitlines()[2:]] for part in printed.out.split("\n\n")
    )
    assert [line[:2] for line in depth] == [["0052", "whole image"], ["0052", "Eigen's crop"]]  # 0039 has no scans
    assert (np.array([line[2:] for line in depth], float) >= 0).all()
    assert [line[:2] for line in cls] == [["0039", str(FRAMES)], ["0052", str(FRAMES)]]
    shares = np.array([line[2:] for line in cls], float)
    assert (shares >= 0).all()
    assert (shares <= 1).all()
    assert (shares[:, 0] <= shares[:, 2]).all()  # what is of one class is of one kind


def test_kinds() -> None:
    cls = np.array([0, 1, 9, 2, 8, 10, 11, 13, 255])
    np.testing.assert_array_equal(real_depth.kinds(cls), [0, 0, 0, 3, 3, 2, 1, 1, 255])


def test_agreement_leaves_out_what_the_teacher_does_not_name() -> None:
    cls, teacher = np.array([[[0, 1, 2]], [[3, 3, 3]]]), np.array([[[0, 2, 255]], [[3, 3, 3]]])
    np.testing.assert_array_equal(real_depth.agreement(cls, teacher), [0.5, 1])


def test_what_is_missing_is_named(roots: tuple[Path, Path], tmp_path: Path) -> None:
    half, kitti = roots
    with pytest.raises(InputError, match=r"no drive .0006.: .*0005"):
        real_depth.main(half, kitti, ["0006"])
    with pytest.raises(InputError, match=r"2011_09_26_drive_0005_sync is missing: extract it there"):
        real_depth.lay_out(kitti, kitti, tmp_path / "raw")
