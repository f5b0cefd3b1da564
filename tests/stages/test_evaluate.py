"""Stage evaluate: figures again from predictions.csv, for the angle and for the path ahead."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.train.trained import load_model
from tests import artefacts
from tests.kitti_drive import contents
from tests.small_model import (
    EDGES_M,
    SPLITS,
    TEST,
    UsersOptions,
    add_users_network,
    run_evaluate,
    run_train,
    write_params,
)

COLUMNS = {
    "angle": ["steering_rad"],
    "path": ["path_0-5m_1pm", "path_5-10m_1pm", "path_10-20m_1pm"],
}


def read_metrics(evaluated: Path) -> dict[str, Any]:
    return json.loads((evaluated / "metrics.json").read_text())


def test_a_seed_that_did_not_train_is_named(folder, capsys):
    write_params(folder, epochs=1, learning_rate=1e-9, seeds=[0])
    run_train(folder)
    metrics = read_metrics(run_evaluate(folder))
    assert metrics["untrained"] == [0]
    assert metrics["train"]["train_mean"]["nmse"] > 0.9
    assert "net: seed 0 failed to train: nmse" in capsys.readouterr().out


@pytest.mark.parametrize("predicted", COLUMNS)
def test_errors_are_means_over_seeds_and_files_repeat(folder, predicted):
    columns = COLUMNS[predicted]
    write_params(folder, {"predict": predicted}, epochs=2, seeds=[0, 7])
    trained = run_train(folder)
    evaluated = run_evaluate(folder)
    before = contents(evaluated)
    assert contents(run_evaluate(folder)) == before

    table = pd.read_csv(evaluated / "predictions.csv")
    errors = []
    for seed, name in ((0, ""), (7, "seed-7")):
        with graph_file.open_graphs(folder / f"graphs/semantic/{TEST}.h5") as graphs:
            expected = load_model(trained / name).predict(graphs)
        rows = table[table["seed"] == seed]
        assert rows["frame"].tolist() == [*range(60)]
        values = rows[[f"predicted_{column}" for column in columns]].to_numpy()
        np.testing.assert_allclose(values, expected, atol=1e-6)
        truth = rows[[f"true_{column}" for column in columns]].to_numpy()
        errors.append(np.nanmean((values - truth) ** 2, axis=0))

    metrics = read_metrics(evaluated)
    ranges = {"angle": ["net"], "path": ["0-5 m/net", "5-10 m/net", "10-20 m/net"]}[predicted]
    ends = {"angle": [], "path": ["at 5 m/net", "at 10 m/net", "at 20 m/net"]}[predicted]
    assert {*metrics["test"]} == {"net", *ranges, *ends}
    assert metrics["frames"] == "frames that net predicts"
    assert "low" not in metrics["test"]["net"]  # one drive, shorter than two blocks
    mse = [metrics["test"][name]["mse"] for name in ranges]
    np.testing.assert_allclose(mse, np.mean(errors, axis=0), rtol=1e-3)

    validation = pd.read_csv(evaluated / "validation.csv", dtype={"drive": str})
    assert [*validation["drive"].unique()] == metrics["drives"]["val"]
    truth = validation[[f"true_{column}" for column in columns]].to_numpy()
    values = validation[[f"predicted_{column}" for column in columns]].to_numpy()
    mse = [metrics["val"][name]["mse"] for name in ranges]
    np.testing.assert_allclose(mse, np.nanmean((values - truth) ** 2, axis=0), rtol=1e-3)

    labels = [h5py.File(folder / f"labels/{drive}.h5") for drive in metrics["drives"]["train"]]
    name, limit = {"angle": ("steering_rad", 0.02), "path": ("ahead_1pm", 1 / 135)}[predicted]
    turns = np.abs(np.concatenate([file[name][:].reshape(60, -1) for file in labels])) > limit
    assert metrics["turning_frames"] == turns.any(axis=1).sum()


def test_the_factor_of_the_regression_is_fitted_on_training_drives(folder):
    """Motion of the training drives is half of what they steer."""
    for drive in [drive for drive, split in SPLITS.items() if split == "train"]:
        with h5py.File(folder / f"labels/{drive}.h5") as labels:
            steering_rad = labels["steering_rad"][:]
        artefacts.write_steered(folder / f"motion/{drive}.h5", steering_rad / 2)
    write_params(folder, epochs=1)
    run_train(folder)
    table = pd.read_csv(run_evaluate(folder) / "predictions.csv")
    table = table[table["frame"] > 0]  # motion is measured in all frames but the first
    regression = table["regression_steering_rad"]
    assert np.abs(regression).max() > 0.1
    np.testing.assert_allclose(regression, 2 * table["odometry_steering_rad"], atol=1e-4)


def test_drives_without_a_window_are_not_listed(folder):
    for drive, frames in zip(SPLITS, (0, 3), strict=False):
        artefacts.write_graphs(
            folder / f"graphs/semantic/{drive}.h5", np.zeros(frames), np.arange(frames), 80
        )
    write_params(folder, epochs=1)
    drives = ["2026_01_01_drive_0003"]
    assert load_model(run_train(folder)).drives == drives
    assert read_metrics(run_evaluate(folder))["drives"]["train"] == drives


@pytest.mark.parametrize(("spatial", "sees"), [("gnn", True), ("users", False)])
def test_metrics_say_whether_the_network_sees_its_frames(folder, monkeypatch, spatial, sees):
    add_users_network(monkeypatch)
    monkeypatch.setattr(UsersOptions, "sees_frames", sees)
    write_params(folder, {"spatial": spatial, "equivariant": False}, epochs=1)
    run_train(folder)
    assert read_metrics(run_evaluate(folder))["sees_frames"] is sees


def test_other_ranges_than_in_training_are_refused(folder):
    write_params(folder, {"predict": "path"}, epochs=1)
    run_train(folder)
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80, ahead_m=EDGES_M[:3])
    with pytest.raises(
        InputError, match=r"the labels have path_0-5m_1pm, .*, the trained model predicts path_0-5m"
    ):
        run_evaluate(folder)


@pytest.mark.parametrize(
    ("section", "key", "before", "after"),
    [
        ("labels", "wheelbase_m", "2.7", "3.5"),
        ("graphs", "keep_inter_class", "0.2", "1.0"),
        ("graphs", "points", "not set", "50"),
    ],
)
def test_files_of_other_settings_than_in_training_are_refused(
    folder, monkeypatch, section, key, before, after
):
    write_params(folder, epochs=1)
    run_train(folder)
    settings = {"labels": artefacts.LABELS, "graphs": artefacts.GRAPHS}[section]
    monkeypatch.setitem(settings, section, settings[section] | {key: float(after)})
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80, ahead_m=EDGES_M)
    problem = rf"{section}\.{key} is {after}.*, but model net was trained with {before}\. Train it"
    with pytest.raises(InputError, match=problem):
        run_evaluate(folder)
