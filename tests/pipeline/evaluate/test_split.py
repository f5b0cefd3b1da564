"""Metrics of a split: counted frames, drives, odometry."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.evaluate import split
from pipeline.settings.evaluate import Evaluate
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.predict import Prediction, Target
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[3] / "params.yaml"
NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def drives(folder: Path, write: object = artefacts.write_graphs, horizon: int = 0) -> list[LabelledDrive]:
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40, write=write)
    return read_drives(folder / "graphs/semantic", folder / "labels", NAMES, 4, horizon=horizon)


def case(drive: LabelledDrive, *seeds: np.ndarray, mean: float = 0.0) -> split.Case:
    return split.Case(drive, [Prediction(angles) for angles in seeds], Target(mean, 1.0, 2.7, 1.0, {"visual": 0.5}))


def metrics(cases: list[split.Case]) -> dict:
    return split.metrics(cases, load(Evaluate, PARAMS))


def test_invalid_and_early_frames_do_not_count(tmp_path: Path) -> None:
    test = drives(tmp_path)
    test[0].valid[10:15] = False
    predicted = [drive.steering_rad + 0.01 for drive in test]
    for angles, drive in zip(predicted, test, strict=True):
        angles[:3] = np.nan
        angles[~drive.valid] = 99.0
    found = metrics([case(drive, angles) for drive, angles in zip(test, predicted, strict=True)])
    assert found["frames"] == 2 * (30 - 3) - 5
    assert found["mse_rad2"] == pytest.approx(0.01**2)
    assert found["nmse_ci95"][0] <= found["nmse"] <= found["nmse_ci95"][1]
    assert found["baselines"]["train_mean"] == found["baselines"]["zero"]
    assert sum(row["frames"] for row in found["by_curvature"]) == found["frames"]
    assert found["nmse_std"] is None


def test_each_drive_has_its_own_errors_and_training_mean(tmp_path: Path) -> None:
    first, second = drives(tmp_path, horizon=2)
    cases = [
        case(first, first.steering_rad + 0.01, first.steering_rad + 0.03),
        case(second, second.steering_rad, second.steering_rad, mean=0.05),
    ]
    found = metrics(cases)["by_drive"]
    assert list(found) == NAMES
    assert found[NAMES[0]]["frames"] == 28  # the last two have no label 2 frames ahead
    assert found[NAMES[0]]["mse_rad2"] == pytest.approx((0.01**2 + 0.03**2) / 2)
    assert found[NAMES[1]]["nmse"] == 0
    assert found[NAMES[0]]["baselines"]["train_mean"] == found[NAMES[0]]["baselines"]["zero"]
    mean = np.mean((second.steering_rad[:28] - 0.05) ** 2)
    assert found[NAMES[1]]["baselines"]["train_mean"]["mse_rad2"] == pytest.approx(mean)
    assert found[NAMES[1]]["baselines"]["persistence"]["mse_rad2"] == pytest.approx(
        np.mean((second.steering_rad[:28] - np.r_[second.persistence_rad[:28]]) ** 2)
    )


def test_odometry_needs_motion_in_all_drives(tmp_path: Path) -> None:
    """The first drive has images and scans; the second has images, and either no scan or no data set of scans."""
    for name, drive in zip(NAMES, drives(tmp_path), strict=True):
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", drive.steering_rad)
        if name == NAMES[0]:
            artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", drive.steering_rad)

    def baselines(horizon: int = 5) -> dict:
        again = read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4, horizon=horizon)
        return metrics([case(drive, np.zeros(30)) for drive in again])

    found, (first, second) = (
        baselines()["baselines"],
        read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4),
    )
    assert list(found) == ["zero", "train_mean", "persistence", "odometry", "regression"]
    assert list(baselines(0)["baselines"]) == ["zero", "train_mean", "persistence", "odometry", "regression"]
    ahead = np.concatenate([drive.steering_rad[5:] - drive.steering_rad[:25] for drive in (first, second)])
    assert found["odometry"]["mse_rad2"] == pytest.approx(np.mean(ahead**2), rel=1e-4)
    half = np.concatenate([drive.steering_rad[5:] - 0.5 * drive.steering_rad[:25] for drive in (first, second)])
    assert found["regression"]["mse_rad2"] == pytest.approx(np.mean(half**2), rel=1e-4)
    assert found["persistence"]["mse_rad2"] == pytest.approx(np.mean(ahead**2))
    artefacts.add_motion(tmp_path / f"graphs/semantic/{NAMES[1]}.h5", second.steering_rad, np.zeros(30, bool))
    found = baselines()
    assert [found["by_drive"][name]["baselines"]["odometry_lidar"]["nmse"] is None for name in NAMES] == [False, True]
    assert found["baselines"]["odometry_lidar"]["nmse"] is None


@pytest.mark.parametrize(("horizon", "kinds"), [(0, ["lidar"]), (5, ["visual", "lidar"])])
def test_odometry_is_not_compared_with_labels_from_the_same_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, horizon: int, kinds: list[str]
) -> None:
    monkeypatch.setitem(artefacts.LABELS["labels"], "source", "visual")
    for drive in drives(tmp_path):
        for kind in ("visual", "lidar"):
            artefacts.add_motion(drive.graphs, kind, drive.steering_rad)
    again = read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4, horizon=horizon)
    cases = [case(drive, np.zeros(30)) for drive in again]
    assert split.measured_kinds(cases) == kinds
    assert {drive.label_source for drive in again} == {"visual"}
    assert split.odometry(cases) == {"kind": kinds[0], "coefficient": {"visual": 0.5}.get(kinds[0])}
    assert ("odometry_lidar" in metrics(cases)["baselines"]) == (len(kinds) == 2)
