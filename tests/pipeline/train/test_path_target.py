"""Scale of the path ahead: regression on the measured curvature, residuals and their inverse."""

from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.train import windows
from pipeline.train.labelled_drive import LabelledDrive, read_drives
from pipeline.train.path_target import PathPrediction, PathTarget
from tests import artefacts
from tests.pipeline.train.shared import DRIVES


@pytest.fixture
def drives(tmp_path: Path) -> list[LabelledDrive]:
    artefacts.write_dataset(tmp_path, DRIVES, frames=40, points=12, ahead_m=[0, 5, 10])
    for name, scale in zip(DRIVES, (0.2, -0.3), strict=True):
        artefacts.add_motion(tmp_path / f"graphs/semantic/{name}.h5", scale * np.sin(np.arange(40) / 5))
    folders = tmp_path / "graphs/semantic", tmp_path / "labels"
    return read_drives(*folders, list(DRIVES), 4, motion="visual", predict="path")


def test_the_base_is_the_regression_on_the_measured_curvature(drives: list[LabelledDrive]) -> None:
    target = PathTarget.from_drives(drives)
    path = np.concatenate([drive.path_1pm for drive in drives])
    measured = np.concatenate([np.tan(drive.base_rad) / 2.7 for drive in drives])
    for number in range(2):
        known = np.isfinite(path[:, number])
        assert 0 < known.sum() < len(path)
        (best,), *_ = np.linalg.lstsq(measured[known, None], path[known, number], rcond=None)
        assert target.base[number] == pytest.approx(best)
        assert target.std_1pm[number] == pytest.approx(np.std(path[known, number] - best * measured[known]))
    assert target.coefficients == {"visual": pytest.approx(target.base)}


def test_outputs_and_paths_are_inverse(drives: list[LabelledDrive]) -> None:
    target = PathTarget.from_drives(drives)
    (batch,) = windows.batches(drives, [windows.spans(drives, 4, 100)], 4)
    assert "steering_rad" not in batch
    tensors = {name: torch.from_numpy(batch[name]).double() for name in ("path_1pm", "base_rad", "valid")}
    outputs = target.residual(tensors)
    assert outputs.shape == tensors["valid"].shape == (74, 2)
    np.testing.assert_allclose(target.decode(outputs, batch["base_rad"]).T, batch["path_1pm"], atol=1e-7)
    assert (outputs.abs().mean(0) < 2).all()
    invalid = ~batch["valid"]
    assert invalid.any()
    assert not batch["path_1pm"][invalid].any()


def test_nmse_is_1_for_the_straight_path_and_ignores_unknown_frames(drives: list[LabelledDrive]) -> None:
    target = PathTarget.from_drives(drives)
    straight = [PathPrediction(np.zeros_like(drive.path_1pm)) for drive in drives]
    assert target.nmse(drives, straight) == pytest.approx(1)
    half = [PathPrediction(np.where(drive.frame[:, None] < 4, np.nan, drive.path_1pm / 2)) for drive in drives]
    assert target.nmse(drives, half) == pytest.approx(0.25)
    unknown = [PathPrediction(np.full_like(drive.path_1pm, np.nan)) for drive in drives]
    assert np.isnan(target.nmse(drives, unknown))


def test_without_motion_the_base_is_zero(drives: list[LabelledDrive]) -> None:
    graphs, labels = drives[0].graphs.parent, drives[0].labels.parent
    target = PathTarget.from_drives(read_drives(graphs, labels, list(DRIVES), 4, predict="path"))
    assert target.base == [0, 0]
    assert target.coefficients["visual"] == pytest.approx(PathTarget.from_drives(drives).base)


def test_a_range_that_is_never_driven(drives: list[LabelledDrive]) -> None:
    graphs, labels = drives[0].graphs.parent, drives[0].labels.parent
    for name in DRIVES:
        artefacts.write_labels(labels / f"{name}.h5", name, np.full(40, 0.1), np.arange(40), ahead_m=[0, 5, 100])
    with pytest.raises(InputError, match=r"no frame is followed by a path from 5 to 100 m in 2026.*labels\.ahead_m"):
        PathTarget.from_drives(read_drives(graphs, labels, list(DRIVES), 4, predict="path"))
