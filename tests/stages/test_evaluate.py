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
from tests.small_model import EDGES_M, SPLITS, TEST, run_evaluate, run_train, write_params

COLUMNS = {
    "angle": ["steering_rad"],
    "path": ["path_0-5m_1pm", "path_5-10m_1pm", "path_10-20m_1pm"],
}


def read_metrics(evaluated: Path) -> dict[str, Any]:
    return json.loads((evaluated / "metrics.json").read_text())


@pytest.mark.parametrize("predicted", COLUMNS)
def test_metrics_are_means_over_seeds_and_files_repeat(folder, predicted):
    write_params(folder, {"predict": predicted}, epochs=2, seeds=[0, 7])
    trained = run_train(folder)
    evaluated = run_evaluate(folder)
    metrics = read_metrics(evaluated)
    before = contents(evaluated)
    assert contents(run_evaluate(folder)) == before
    predictions = pd.read_csv(evaluated / "predictions.csv")
    tables = [table.reset_index() for _, table in predictions.groupby("seed")]
    for table, seed in zip(tables, ("", "seed-7"), strict=True):
        with graph_file.open_graphs(folder / f"graphs/semantic/{TEST}.h5") as graphs:
            model = load_model(trained / seed)
            values = model.predict(graphs)
        assert table["frame"].tolist() == [*range(60)]
        found = table[[f"predicted_{name}" for name in COLUMNS[predicted]]]
        np.testing.assert_allclose(found, values, atol=1e-6)
        assert np.isnan(values).all(axis=1).tolist() == [True] * 3 + [False] * 57
        odometry = table[f"odometry_{COLUMNS[predicted][0]}"]
        assert odometry.isna().tolist() == [True] + [False] * 59, "unknown in the first frame"
    labels = [h5py.File(folder / f"labels/{drive}.h5") for drive in metrics["drives"]["train"]]
    name, limit = {"angle": ("steering_rad", 0.02), "path": ("ahead_1pm", 1 / 135)}[predicted]
    turns = np.abs(np.concatenate([file[name][:].reshape(60, -1) for file in labels])) > limit
    assert metrics["turning_frames"] == turns.any(axis=1).sum()
    ranges = {"angle": ["net"], "path": ["0-5 m/net", "5-10 m/net", "10-20 m/net"]}[predicted]
    assert {*metrics["test"]} == {"net", *ranges}
    for key, name in zip(ranges, COLUMNS[predicted], strict=True):
        row = metrics["test"][key]
        rows = [table.dropna(subset=[f"true_{name}", f"predicted_{name}"]) for table in tables]
        true = rows[0][f"true_{name}"]
        mse = [((table[f"predicted_{name}"] - true) ** 2).mean() for table in rows]
        zero = (true**2).mean()
        assert row["frames"] == len(true)
        assert row["mse"] == pytest.approx(np.mean(mse), rel=1e-3)
        assert row["nmse"] == pytest.approx(np.mean(mse) / zero, rel=1e-3)
        np.testing.assert_allclose(row["seeds"], np.array(mse) / zero, rtol=1e-2)
        assert "low" not in row  # one drive, shorter than two blocks


def test_drives_without_a_window_are_not_listed(folder):
    for drive, frames in zip(SPLITS, (0, 3), strict=False):
        artefacts.write_graphs(
            folder / f"graphs/semantic/{drive}.h5", np.zeros(frames), np.arange(frames), 80
        )
    write_params(folder, epochs=1)
    trained = load_model(run_train(folder))
    assert (
        trained.drives
        == read_metrics(run_evaluate(folder))["drives"]["train"]
        == ["2026_01_01_drive_0003"]
    )


def test_other_ranges_than_in_training_are_refused(folder):
    write_params(folder, {"predict": "path"}, epochs=1)
    run_train(folder)
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80, ahead_m=EDGES_M[:3])
    with pytest.raises(
        InputError, match=r"the labels have path_0-5m_1pm, .*, the trained model predicts path_0-5m"
    ):
        run_evaluate(folder)
