"""Models that predict the path ahead, through the stages train and evaluate."""

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.graphs import graph_file
from pipeline.train import fit, predict
from pipeline.train.labelled_drive import read_drive
from tests import artefacts
from tests.small_model import SPLITS, run_evaluate, run_train, write_params

EDGES_M = [0, 5, 10, 20]
NAMES = ["0-5", "5-10", "10-20"]
TEST = "2026_01_03_drive_0001"


@pytest.fixture(autouse=True)
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEER_WORKERS", "1")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Small graphs with measured motion, and labels with the path ahead."""
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=80, ahead_m=EDGES_M)
    for drive in SPLITS:
        with DriveReader(tmp_path / f"labels/{drive}.h5", stage="labels") as truth:
            artefacts.add_motion(tmp_path / f"graphs/semantic/{drive}.h5", truth["steering_rad"])
    return tmp_path


def test_a_path_is_learned_from_the_scene_and_scored_by_range(data: Path) -> None:
    """Second route: all figures again from predictions.csv and Python's predictions."""
    write_params(data, {"predict": "path"}, epochs=12, average=0.0, seeds=[0, 7])
    trained, evaluated = run_train(data), run_evaluate(data)
    metrics = json.loads((evaluated / "metrics.json").read_text())
    assert [(row["from_m"], row["to_m"]) for row in metrics["test"]] == [(0, 5), (5, 10), (10, 20)]
    assert metrics["train"][0]["nmse"] < 0.6
    runs = [pd.read_csv(evaluated / folder / "predictions.csv") for folder in ("", "seed-7")]
    for table, folder in zip(runs, ("", "seed-7"), strict=True):
        with graph_file.open_graphs(data / f"graphs/semantic/{TEST}.h5") as graphs:
            path_1pm = predict.load(trained / folder).predict(graphs)
        assert path_1pm.shape == (60, 3)
        np.testing.assert_allclose(table[[f"predicted_{name}_1pm" for name in NAMES]], path_1pm, atol=1e-6)
        assert np.isnan(path_1pm).any(axis=1).tolist() == [True] * 3 + [False] * 57
    coefficients = predict.load(trained).target.coefficients["visual"]
    for name, coefficient, scores in zip(NAMES, coefficients, metrics["test"], strict=True):
        rows = [table.dropna(subset=[f"driven_{name}_1pm", f"predicted_{name}_1pm"]) for table in runs]
        driven, measured = rows[0][f"driven_{name}_1pm"], rows[0]["measured_1pm"]
        error = np.mean([((table[f"predicted_{name}_1pm"] - driven) ** 2).sum() for table in rows])
        zero = (driven**2).sum()
        assert scores["frames"] == len(driven)
        assert scores["nmse"] == pytest.approx(error / zero, rel=1e-3)
        assert scores["nmse_ci95"] is None  # one drive, not longer than a block
        assert scores["baselines"]["held"] == pytest.approx(((measured - driven) ** 2).sum() / zero, rel=1e-3)
        regression = ((coefficient * measured - driven) ** 2).sum() / zero
        assert scores["baselines"]["regression"] == pytest.approx(regression, rel=1e-3)
        assert scores["baselines"]["zero"] == 1
        assert scores["without_decisions"]["frames"] == len(driven)  # the drives have no corner


def test_the_band_contains_two_thirds_of_the_validation_errors(data: Path) -> None:
    """Second route: coverage again from predictions.csv, and the validation drive's from Python's predictions."""
    write_params(data, {"predict": "path", "motion": "visual", "uncertainty": True}, epochs=4)
    trained, evaluated = run_train(data), run_evaluate(data)
    metrics, table = json.loads((evaluated / "metrics.json").read_text()), pd.read_csv(evaluated / "predictions.csv")
    for name, scores in zip(NAMES, metrics["test"], strict=True):
        rows = table.dropna(subset=[f"driven_{name}_1pm", f"predicted_{name}_1pm"])
        within = (rows[f"predicted_{name}_1pm"] - rows[f"driven_{name}_1pm"]).abs() <= rows[f"sigma_{name}_1pm"]
        assert scores["coverage_68"] == pytest.approx(within.mean(), abs=0.03)  # six decimals
    drive = read_drive(data / "graphs/semantic", data / "labels", "2026_01_02_drive_0001", predict="path")
    with graph_file.open_graphs(drive.graphs) as graphs:
        path_1pm, sigma_1pm = predict.load(trained, "cpu").predict_with_sigma(graphs)
    known = np.isfinite(path_1pm) & np.isfinite(drive.path_1pm)
    within = (np.abs(path_1pm - drive.path_1pm) <= sigma_1pm).sum(axis=0) / known.sum(axis=0)
    np.testing.assert_allclose(within, 0.6827, atol=0.03)


def test_points_without_edges_are_evaluated(data: Path) -> None:
    for drive in SPLITS:
        with h5py.File(data / f"graphs/semantic/{drive}.h5", "a") as file:
            file.attrs["params"] = file.attrs["params"].replace('"k": 6', '"k": 0')
    write_params(data, {"predict": "path", "spatial": "polar"}, epochs=1)
    run_train(data)
    assert json.loads((run_evaluate(data) / "metrics.json").read_text())["variant"]["k"] == 0


@pytest.mark.parametrize("spatial", ["gnn", "polar"])
def test_the_control_with_another_scene_learns_nothing(data: Path, spatial: str) -> None:
    nmse = {}
    for scene in ("same", "another"):
        write_params(data, {"predict": "path", "spatial": spatial, "scene": scene}, epochs=12, average=0.0)
        run_train(data)
        nmse[scene] = json.loads((run_evaluate(data) / "metrics.json").read_text())["train"][0]["nmse"]
    assert nmse["same"] < 0.75
    assert nmse["another"] > 0.9


def test_mirrored_drives_give_the_mirrored_path(data: Path) -> None:
    write_params(data, {"predict": "path", "motion": "visual", "equivariant": True, "uncertainty": True}, epochs=2)
    model, path = predict.load(run_train(data)), data / f"graphs/semantic/{TEST}.h5"
    with graph_file.open_graphs(path) as graphs:
        left = model.predict(graphs)
    with h5py.File(path, "a") as file:
        file["xyz"][:, 0] = -file["xyz"][:, 0]
        file["visual_yaw_rate_radps"][:] = -file["visual_yaw_rate_radps"][:]
    with graph_file.open_graphs(path) as graphs:
        np.testing.assert_allclose(model.predict(graphs), -left, atol=1e-8)
    assert np.nanmax(np.abs(left)) > 1e-3


def test_scenes_are_rescaled_and_motion_is_hidden_only_for_paths(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, list[np.ndarray]] = {"path": [], "angle": []}

    def record(predict_: str) -> None:
        write_params(data, {"predict": predict_, "motion": "visual"}, epochs=2)
        read = fit.reading.Reader.__getitem__

        def watched(self: object, step: fit.reading.TrainStep) -> dict[str, torch.Tensor]:
            batch = read(self, step)
            seen[predict_].append(batch["motion"].numpy())
            return batch

        with monkeypatch.context() as patch:
            patch.setattr(fit.reading.Reader, "__getitem__", watched)
            run_train(data)

    record("path"), record("angle")
    hidden = np.concatenate([(rows == 0).all(axis=1) for rows in seen["path"]])
    assert 0 < hidden.mean() < 0.7
    speeds = {name: np.concatenate([rows[:, 2] for rows in batches]) for name, batches in seen.items()}
    assert (speeds["angle"] > 0).all()
    for speed in speeds["angle"], speeds["path"][~hidden]:
        assert len(set(speed.tolist())) > 2


def test_resumed_training_writes_the_same_bytes(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_params(data, {"predict": "path", "motion": "visual"}, epochs=3)
    complete = (run_train(data) / "best.pt").read_bytes()
    (data / "train/net/best.pt").unlink()
    write = fit.checkpoint.write

    def interrupt(path: Path, content: dict[str, object]) -> None:
        write(path, content)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(fit.checkpoint, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_train(data)
    assert (run_train(data) / "best.pt").read_bytes() == complete


def test_labels_without_the_path_are_refused(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=20)
    write_params(tmp_path, {"predict": "path"})
    with pytest.raises(InputError, match=r"labels/2026.*no path ahead.*dvc repro labels") as raised:
        run_train(tmp_path)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "train").exists()


@pytest.mark.parametrize(
    ("frames", "problem"),
    [(5, "no window of 4 consecutive frames with a driven path of 5 m ahead"), (20, "path from 10 to 20 m")],
)
def test_too_short_drives_are_one_clear_line(tmp_path: Path, frames: int, problem: str) -> None:
    """At 8 m/s, 5 frames are 3.2 m and 20 frames 15 m."""
    artefacts.write_dataset(tmp_path, SPLITS, frames=frames, points=20, ahead_m=EDGES_M)
    write_params(tmp_path, {"predict": "path"}, epochs=1)
    with pytest.raises(InputError, match=problem) as raised:
        run_train(tmp_path)
    assert "\n" not in str(raised.value)
    assert "Add longer drives" in str(raised.value) or "other drives" in str(raised.value)
    assert not (tmp_path / "train").exists()


def test_other_ranges_than_in_training_are_refused(data: Path) -> None:
    write_params(data, {"predict": "path"}, epochs=1)
    run_train(data)
    artefacts.write_dataset(data, SPLITS, frames=60, points=80, ahead_m=[0, 10])
    with pytest.raises(InputError, match=r"labels\.ahead_m differs from the ranges of the trained model"):
        run_evaluate(data)
