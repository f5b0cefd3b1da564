"""The figures of a split: which frames count, and what is measured of its graphs."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.params import load
from pipeline.report.judge import split
from pipeline.sections.evaluate import Evaluate
from pipeline.train import windows
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[4] / "params.yaml"
NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def drives(folder: Path, write: object = artefacts.write_graphs) -> list[windows.Drive]:
    artefacts.write_dataset(folder, dict.fromkeys(NAMES, "test"), frames=30, points=40, write=write)
    return windows.read_drives(folder / "graphs/semantic", folder / "labels", NAMES, 4)


def test_invalid_and_early_frames_do_not_count(tmp_path: Path) -> None:
    test = drives(tmp_path)
    test[0].valid[10:15] = False
    predicted = [drive.steering_rad + 0.01 for drive in test]
    for angles, drive in zip(predicted, test, strict=True):
        angles[:3] = np.nan
        angles[~drive.valid] = 99.0
    figures = split.figures(test, [predicted], load(Evaluate, PARAMS), train_mean_rad=0.0)
    assert figures["frames"] == 2 * (30 - 3) - 5
    assert figures["mse_rad2"] == pytest.approx(0.01**2)
    assert figures["nmse_ci95"][0] <= figures["nmse"] <= figures["nmse_ci95"][1]
    assert figures["baselines"]["train_mean"] == figures["baselines"]["zero"]
    assert sum(row["frames"] for row in figures["by_curvature"]) == figures["frames"]
    assert figures["nmse_std"] is None


def test_sizes_are_means_and_none_of_what_there_is_not(tmp_path: Path) -> None:
    sizes = split.sizes(drives(tmp_path / "graphs"))
    assert sizes["points_per_frame"] == 40
    assert 0 < sizes["edges_per_frame"] < sizes["edges_per_frame_unpruned"]
    of_images = split.sizes(drives(tmp_path / "images", artefacts.write_images))
    assert set(of_images.values()) == {None}
