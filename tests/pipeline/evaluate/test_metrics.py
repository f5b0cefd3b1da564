"""Metrics of a split: counted frames, drives, baselines."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.evaluate import metrics
from pipeline.settings.evaluate import Evaluate
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.scale import Prediction, Scale
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[3] / "params.yaml"
NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(folder: Path, horizon: int = 0) -> list[LabelledDrive]:
    return read_drives(folder / "graphs/semantic", folder / "labels", NAMES, 4, horizon=horizon)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    return tmp_path


def case(drive: LabelledDrive, *seeds: np.ndarray, mean: float = 0.0) -> metrics.Case:
    gain = None if drive.odometry is None else np.array([0.5])
    scale = Scale(["steering_rad"], np.ones(1), np.ones(1), np.array([mean]), gain)
    return metrics.Case(drive, [Prediction(angles) for angles in seeds], scale)


def scores(cases: list[metrics.Case]) -> dict[str, Any]:
    return metrics.metrics(cases, load(Evaluate, PARAMS))["steering_rad"]


def test_invalid_and_early_frames_do_not_count(folder: Path) -> None:
    test = read(folder)
    test[0].valid[10:15] = False
    predicted = [drive.target + 0.01 for drive in test]
    for angles, drive in zip(predicted, test, strict=True):
        angles[:3] = np.nan
        angles[~drive.valid] = 99.0
    found = scores([case(drive, angles) for drive, angles in zip(test, predicted, strict=True)])
    assert found["frames"] == 2 * (30 - 3) - 5
    assert found["mse"] == pytest.approx(0.01**2)
    assert found["nmse_ci95"][0] <= found["nmse"] <= found["nmse_ci95"][1]
    assert found["baselines"]["train_mean"] == found["baselines"]["zero"]
    assert found["nmse_std"] is None
    assert [row["from_1pm"] for row in found["by_curvature"]] == [0.0, 0.005, 0.03]
    for row in found["by_curvature"]:
        inside = [d.valid & (np.abs(d.curvature_1pm) >= row["from_1pm"]) for d in test]
        inside = [m & (np.abs(d.curvature_1pm) < (row["to_1pm"] or 9)) for m, d in zip(inside, test, strict=True)]
        angles = np.concatenate([d.target[3:][m[3:]] for m, d in zip(inside, test, strict=True)])
        assert row["frames"] == len(angles) > 0
        assert row["zero"]["mse"] == pytest.approx(np.mean(angles**2))


def test_each_drive_has_its_own_errors_and_training_mean(folder: Path) -> None:
    first, second = read(folder, horizon=2)
    cases = [
        case(first, first.target + 0.01, first.target + 0.03),
        case(second, second.target, second.target, mean=0.05),
    ]
    found = scores(cases)["by_drive"]
    assert list(found) == NAMES
    assert found[NAMES[0]]["frames"] == 28  # the last two have no label 2 frames ahead
    assert found[NAMES[0]]["mse"] == pytest.approx((0.01**2 + 0.03**2) / 2)
    assert found[NAMES[1]]["nmse"] == 0
    truth, baselines = second.target[:28], found[NAMES[1]]["baselines"]
    assert baselines["train_mean"]["mse"] == pytest.approx(np.mean((truth - 0.05) ** 2))
    assert baselines["persistence"]["mse"] == pytest.approx(np.mean((truth - second.persistence[:28]) ** 2))


@pytest.mark.parametrize("source", ["oxts", "visual"])
def test_odometry_needs_motion_in_all_drives_and_other_labels(
    folder: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    """At horizon 0, labels from visual odometry are not compared with it. The second drive has no measurement."""
    monkeypatch.setitem(artefacts.LABELS["labels"], "source", source)
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    without = ["zero", "train_mean", "persistence"]

    def baselines(horizon: int) -> dict[str, Any]:
        return scores([case(drive, np.zeros((30, 1))) for drive in read(folder, horizon)])["baselines"]

    first, second = read(folder)
    assert list(baselines(5)) == without
    artefacts.add_motion(first.graphs, first.target[:, 0])
    assert list(baselines(5)) == without
    artefacts.add_motion(second.graphs, second.target[:, 0], np.zeros(30, bool))
    assert baselines(5)["odometry"]["nmse"] is None
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40)
    for drive in (first, second):
        artefacts.add_motion(drive.graphs, drive.target[:, 0])
    found = baselines(5)
    assert list(found) == [*without, "odometry", "regression"]
    for name, gain in {"odometry": 1.0, "regression": 0.5}.items():
        ahead = np.concatenate([drive.target[5:] - gain * drive.target[:25] for drive in (first, second)])
        assert found[name]["mse"] == pytest.approx(np.mean(ahead**2), rel=1e-4)
    assert list(baselines(0)) == without + ["odometry", "regression"] * (source == "oxts")
