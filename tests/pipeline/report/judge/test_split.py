"""The figures of a split: which frames count, what is said of parts, and what is measured of its graphs."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.report.judge import decisions, split
from pipeline.sections.evaluate import Evaluate
from pipeline.train import windows
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[4] / "params.yaml"
NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def drives(folder: Path, write: object = artefacts.write_graphs, horizon: int = 0) -> list[windows.Drive]:
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40, write=write)
    return windows.read_drives(folder / "graphs/semantic", folder / "labels", NAMES, 4, horizon)


def figures(cases: list[split.Case]) -> dict:
    return split.figures(cases, load(Evaluate, PARAMS))


def test_invalid_and_early_frames_do_not_count(tmp_path: Path) -> None:
    test = drives(tmp_path)
    test[0].valid[10:15] = False
    predicted = [drive.steering_rad + 0.01 for drive in test]
    for angles, drive in zip(predicted, test, strict=True):
        angles[:3] = np.nan
        angles[~drive.valid] = 99.0
    made = figures([split.Case(drive, angles[None], 0.0) for drive, angles in zip(test, predicted, strict=True)])
    assert made["frames"] == 2 * (30 - 3) - 5
    assert made["mse_rad2"] == pytest.approx(0.01**2)
    assert made["nmse_ci95"][0] <= made["nmse"] <= made["nmse_ci95"][1]
    assert made["baselines"]["train_mean"] == made["baselines"]["zero"]
    assert sum(row["frames"] for row in made["by_curvature"]) == made["frames"]
    assert made["nmse_std"] is None


def test_each_drive_is_judged_alone_too_by_its_own_training_mean(tmp_path: Path) -> None:
    first, second = drives(tmp_path, horizon=2)
    cases = [
        split.Case(first, np.stack([first.steering_rad + 0.01, first.steering_rad + 0.03]), 0.0),
        split.Case(second, np.stack([second.steering_rad, second.steering_rad]), 0.05),
    ]
    made = figures(cases)["by_drive"]
    assert list(made) == NAMES
    assert made[NAMES[0]]["frames"] == 28  # of the last two, nothing was recorded
    assert made[NAMES[0]]["mse_rad2"] == pytest.approx((0.01**2 + 0.03**2) / 2)
    assert made[NAMES[1]]["nmse"] == 0
    assert made[NAMES[0]]["baselines"]["train_mean"] == made[NAMES[0]]["baselines"]["zero"]
    mean = np.mean((second.steering_rad[:28] - 0.05) ** 2)
    assert made[NAMES[1]]["baselines"]["train_mean"]["mse_rad2"] == pytest.approx(mean)
    assert made[NAMES[1]]["baselines"]["persistence"]["mse_rad2"] == pytest.approx(
        np.mean((second.steering_rad[:28] - np.r_[second.held_rad[:28]]) ** 2)
    )


def test_the_network_that_judges_a_drive_more_than_once_has_the_mean(tmp_path: Path) -> None:
    (first, _) = drives(tmp_path)
    cases = [split.Case(first, first.steering_rad[None] + error, 0.0) for error in (0.01, 0.03)]
    made = figures(cases)
    assert made["by_drive"][NAMES[0]]["frames"] == made["frames"] == 60
    assert made["by_drive"][NAMES[0]]["mse_rad2"] == pytest.approx(made["mse_rad2"])


def test_odometry_is_none_where_a_drive_has_no_scans(tmp_path: Path) -> None:
    for name, drive in zip(NAMES, drives(tmp_path), strict=True):
        has_scans = np.full(30, name == NAMES[0])
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", "visual", drive.steering_rad)
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", "lidar", drive.steering_rad, has_scans)
    again = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4)
    made = figures([split.Case(drive, np.zeros((1, 30)), 0.0) for drive in again])
    of_drives = [made["by_drive"][name]["baselines"]["odometry_lidar"]["nmse"] for name in NAMES]
    assert of_drives == [pytest.approx(0, abs=1e-6), None]
    assert made["baselines"]["odometry_lidar"]["nmse"] is None
    assert made["baselines"]["odometry"]["nmse"] == pytest.approx(0, abs=1e-6)


def test_odometry_is_judged_where_all_drives_carry_it(tmp_path: Path) -> None:
    first, second = drives(tmp_path)
    for name, drive in zip(NAMES, (first, second), strict=True):
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", "visual", drive.steering_rad)
    artefacts.add_motion(tmp_path / f"graphs/semantic/{NAMES[0]}.h5", "lidar", first.steering_rad)
    again = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4, 5)
    made = figures([split.Case(drive, np.zeros((1, 30)), 0.0) for drive in again])["baselines"]
    assert list(made) == ["zero", "train_mean", "persistence", "odometry"]
    ahead = np.concatenate([drive.steering_rad[5:] - drive.steering_rad[:25] for drive in (first, second)])
    assert made["odometry"]["mse_rad2"] == pytest.approx(np.mean(ahead**2), rel=1e-4)
    assert made["persistence"]["mse_rad2"] == pytest.approx(np.mean(ahead**2))


def test_frames_at_decisions_count_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (first, _) = drives(tmp_path)
    near = np.arange(30) < 10
    monkeypatch.setattr(decisions, "near", lambda drive: near)
    made = figures([split.Case(first, np.where(near, 0.0, first.steering_rad)[None], 0.0)])
    assert made["nmse"] > 0
    assert (made["without_decisions"]["frames"], made["without_decisions"]["nmse"]) == (20, 0)
    assert made["without_decisions"]["baselines"]["zero"]["frames"] == 20
    monkeypatch.setattr(decisions, "near", lambda drive: np.ones(30, bool))
    assert figures([split.Case(first, np.zeros((1, 30)), 0.0)])["without_decisions"]["nmse"] is None


def test_sizes_are_means_and_none_of_what_there_is_not(tmp_path: Path) -> None:
    sizes = split.sizes(drives(tmp_path / "graphs"))
    assert sizes["points_per_frame"] == 40
    assert 0 < sizes["edges_per_frame"] < sizes["edges_per_frame_unpruned"]
    of_images = split.sizes(drives(tmp_path / "images", artefacts.write_images))
    assert set(of_images.values()) == {None}


def test_paths_are_integrated_as_the_params_say(tmp_path: Path) -> None:
    cases = [split.Case(drive, drive.steering_rad[None] + 0.03, 0.0) for drive in drives(tmp_path)]
    settings = load(Evaluate, PARAMS)
    assert settings.path == "bicycle"
    of_car, of_paper = (
        split.figures(cases, settings.model_copy(update={"path": path}))["drift_m_per_100m"]
        for path in ("bicycle", "paper")
    )
    assert of_paper == pytest.approx(100 * 2 * np.sin(0.03 / 2), rel=0.01)  # where the way is all but straight
    assert of_car > 2 * of_paper
