import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.camera import classes
from pipeline.camera.images import to_metres, to_units
from pipeline.encoder.truth import read_truth
from pipeline.motion import kinds
from pipeline.perception.ground_plane import ground_plane_depth
from pipeline.perception.scores import depth_errors
from pipeline.sections.perception import Perception
from stages.scores import main
from tests import street

SPLITS = {"2026_01_01_drive_0001": "train", "2026_01_03_drive_0001": "test", "2026_01_03_drive_0002": "test"}
DENSE, LIDAR, BLIND = SPLITS
LABELS = {"wheelbase_m": 2.7, "min_speed_mps": 1.0, "standstill": "invalid"}
FACTOR = 1.1  # of each perceived depth


def write_perceived(root: Path, drive: str, **settings: object) -> None:
    """Write depth that is too large by FACTOR, with holes, and partly wrong classes."""
    params = {"perception": Perception(batch=1, **settings).model_dump()}
    with (
        store.DriveReader(root / "ingest" / f"{drive}.h5", stage="ingest") as source,
        store.DriveWriter(
            root / "perception" / f"{drive}.h5", stage="perception", drive=drive, params=params
        ) as target,
    ):
        numbers = source.frame[source["has_image"].astype(bool)]
        scenes = [street.scene(number) for number in numbers]
        depth = np.array([FACTOR * depth_m for _, depth_m, _ in scenes]).reshape(-1, *street.SIZE)
        cls = np.array([cls for *_, cls in scenes], np.uint8).reshape(-1, *street.SIZE)
        cls[:, :3] = classes.VEGETATION
        depth[:, :, :9] = 0
        target.attrs["camera_height_m"] = settings.get("camera_height_m", 1.65)
        target.put("frame", numbers)
        target.put("depth_m", to_units(depth))
        target.put("cls", cls)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Drives with dense truth, with LiDAR alone and without images, and their files of perception."""
    street.write_drive(tmp_path / "ingest", DENSE, 6)
    street.write_drive(tmp_path / "ingest", LIDAR, 5, dense=False, lidar=True)
    street.write_drive(tmp_path / "ingest", BLIND, 3, dense=False, images=False)
    for drive in SPLITS:
        write_perceived(tmp_path, drive)
    store.write_index(tmp_path / "perception", SPLITS)
    kinds.write(tmp_path / "motion", [])
    return tmp_path


def run(root: Path) -> dict:
    (root / "params.yaml").write_text(yaml.safe_dump({"labels": LABELS}))
    out = root / "scores"
    assert main(root / "ingest", root / "perception", root / "motion", out, root / "params.yaml", workers=1) == out
    return json.loads((out / "metrics.json").read_text())


def errors(root: Path, drive: str, flat: bool) -> tuple[float, float]:
    """Return abs rel and coverage of a drive, frame by frame from the files."""
    found, covered = [], []
    with (
        store.DriveReader(root / "ingest" / f"{drive}.h5", stage="ingest") as source,
        store.DriveReader(root / "perception" / f"{drive}.h5", stage="perception") as file,
    ):
        for row, (depth, cls) in enumerate(zip(file["depth_m"], file["cls"], strict=True)):
            truth_m = read_truth(source, row).depth_m
            known = (truth_m >= 1) & (truth_m <= 80)
            covered.append((known & (depth > 0), known))
            predicted = ground_plane_depth(cls, street.K, 1.65) if flat else to_metres(depth)
            found.append(depth_errors(np.where(depth > 0, predicted, 0), truth_m))
    both, known = np.sum(covered, axis=(0, 2, 3))
    return np.mean(found, axis=0)[0], both / known


@pytest.mark.parametrize("flat", [False, True])
def test_scores_equal_errors_computed_from_the_files(folder: Path, flat: bool) -> None:
    metrics = run(folder)
    key = "ground_plane" if flat else "depth"
    for split, drive, truth in (("train", DENSE, "dense"), ("test", LIDAR, "lidar")):
        score = metrics[split][f"{key}_{truth}"]
        assert (score["abs_rel"], score["coverage"]) == pytest.approx(errors(folder, drive, flat))
        assert 0.5 < score["coverage"] < 0.95
        assert metrics[split][f"{key}_{'lidar' if truth == 'dense' else 'dense'}"] is None
    assert metrics["train"]["depth_dense"]["abs_rel"] == pytest.approx(FACTOR - 1, rel=0.01)
    assert metrics["test"]["depth_lidar"]["frames"] == 5
    assert metrics["test"]["classes"] is None
    assert set(metrics["val"].values()) == {None}


def test_each_drive_has_its_own_scores(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metrics = run(folder)
    drives = {drive: json.loads((folder / "scores" / drive / "metrics.json").read_text()) for drive in SPLITS}
    assert drives[DENSE] == {**metrics["train"], "motion": {}}
    assert {**drives[BLIND], "motion": None} == {**dict.fromkeys(metrics["val"]), "motion": None}
    assert "no ground truth" in capsys.readouterr().out


def test_frames_are_matched_by_number(folder: Path) -> None:
    before = run(folder)["train"]["depth_dense"]["abs_rel"]
    with (
        store.DriveReader(folder / "perception" / f"{DENSE}.h5", stage="perception") as file,
        store.DriveWriter(
            folder / "some" / f"{DENSE}.h5", stage="perception", drive=DENSE, params=file.params
        ) as target,
    ):
        target.attrs["camera_height_m"] = file.attrs["camera_height_m"]
        for name in ("frame", "depth_m", "cls"):
            target.put(name, file[name][[1, 4]])
    (folder / "some" / f"{DENSE}.h5").replace(folder / "perception" / f"{DENSE}.h5")
    score = run(folder)["train"]["depth_dense"]
    assert score["frames"] == 2
    assert score["abs_rel"] == pytest.approx(before, rel=1e-3)


@pytest.mark.parametrize("stage", ["perception", "motion"])
def test_a_missing_input_is_one_error_with_a_command(folder: Path, stage: str) -> None:
    (folder / stage / "index.json").unlink()
    with pytest.raises(InputError, match=f"dvc repro {stage}"):
        run(folder)


def test_measured_motion_is_scored_against_oxts(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ground truth is 8 m/s straight on; measured are 8.8 m/s, and nothing in the first frame.

    A drive also has recorded angles, of which the measured ones differ by a tenth.
    """
    angle = float(np.arctan(2.7 * 0.01 / 8.8)) / 1.1
    with h5py.File(folder / f"ingest/{LIDAR}.h5", "a") as file:
        file["steering_rad"], file["has_steering"] = np.full(5, angle), np.ones(5, np.uint8)
    for drive in SPLITS:
        with (
            store.DriveReader(folder / "perception" / f"{drive}.h5", stage="perception") as perceived,
            store.DriveWriter(
                folder / "motion/visual" / f"{drive}.h5", stage="motion", drive=drive, params={}
            ) as motion,
        ):
            valid = np.arange(len(perceived.frame)) > 0
            motion.put("frame", perceived.frame)
            motion.put("yaw_rate_radps", np.float32(0.01) * valid)
            motion.put("speed_mps", np.float32(8.8) * valid)
            motion.put("valid", valid.astype(np.uint8))
    store.write_index(folder / "motion/visual", SPLITS)
    kinds.write(folder / "motion", ["visual"])
    motion, out = run(folder)["motion"], folder / "scores"
    scores = motion["visual"]
    assert set(motion) == {"visual", "wheel", "visual-wheel"}
    assert motion["wheel"]["test"]["valid"] == 1
    assert motion["visual-wheel"]["train"] is None
    assert motion["visual-wheel"]["test"]["nmse"] == pytest.approx(0.01, rel=1e-3)
    assert scores["test"] == {
        "drives": 1,  # the blind one has no frames
        "frames": 5,
        "valid": 0.8,
        "judged": 4,
        "yaw_rmse_degps": pytest.approx(np.degrees(0.01)),
        "yaw_median_degps": pytest.approx(np.degrees(0.01)),
        "speed_ratio": pytest.approx(1.1),
        "nmse": None,  # a straight road
    }
    assert scores["val"] is None
    assert json.loads((out / DENSE / "metrics.json").read_text())["motion"]["visual"] == scores["train"]
    assert (
        "visual motion, test: 80% of 5 frames measured, yaw rate to 0.57 deg/s, speed x 1.100"
        in capsys.readouterr().out
    )
