import csv
import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.graphs import graph_file
from pipeline.train import predict
from pipeline.train.labelled_drive import read_drive
from stages import evaluate, report
from tests.small_model import run_evaluate, run_train, write_params, write_two_test_drives


@pytest.fixture(autouse=True)
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train seeds and folds one after the other; starting processes takes longer than these trainings."""
    monkeypatch.setenv("STEER_WORKERS", "1")


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_metrics_are_means_over_seeds(folder: Path) -> None:
    """And predict in Python gives the numbers of predictions.csv, for each seed."""
    write_params(folder, seeds=[0, 7], epochs=1)
    trained, evaluated = run_train(folder), run_evaluate(folder)
    both = json.loads((evaluated / "metrics.json").read_text())["test"]
    errors = []
    for seed in ("", "seed-7/"):
        rows = read(evaluated / f"{seed}predictions.csv")
        error = [float(row["predicted_rad"]) - float(row["steering_rad"]) for row in rows if row["predicted_rad"]]
        errors.append(np.mean(np.square(error)))
        with graph_file.open_graphs(folder / "graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
            model = predict.load(str(trained / seed))
            angles, some = model.predict(graphs), model.predict(graphs, [59, 2, 30])
        assert [row["predicted_rad"] for row in rows] == [_text(angle) for angle in angles]
        assert some == pytest.approx(angles[[59, 2, 30]], abs=1e-6, nan_ok=True)
    assert both["mse_rad2"] == pytest.approx(np.mean(errors), rel=1e-3)
    zero = both["baselines"]["zero"]["mse_rad2"]
    assert both["nmse_std"] == pytest.approx(abs(errors[0] - errors[1]) / zero / np.sqrt(2), rel=1e-2)
    report.main(folder, folder / "report", folder / "params.yaml")
    assert "Means over 2 seeds" in " ".join((folder / "report/table.md").read_text().split())


def test_uncertainty_is_calibrated_on_validation_drives(folder: Path) -> None:
    write_params(folder, {"uncertainty": True}, epochs=2)
    trained, evaluated = run_train(folder), run_evaluate(folder)
    assert json.loads((evaluated / "metrics.json").read_text())["test"]["uncertainty"]["nll"] < 9
    model, val = predict.load(trained), "2026_01_02_drive_0001"
    drive = read_drive(folder / "graphs/semantic", folder / "labels", val)
    with graph_file.open_graphs(drive.graphs) as graphs:
        predicted = model.predict_with_sigma(graphs)
    ratio = (predicted.steering_rad - drive.steering_rad) / predicted.sigma_rad
    assert np.nanmean(ratio**2) == pytest.approx(1, rel=1e-6)
    inside = np.abs(predicted.steering_rad - drive.steering_rad) <= predicted.half_95_rad
    assert inside[~np.isnan(ratio)].mean() == pytest.approx(0.95, abs=0.02)
    rows = read(evaluated / "predictions.csv")
    with graph_file.open_graphs(folder / "graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
        predicted = model.predict_with_sigma(graphs, [3, 59])
    assert predicted.sigma_rad is not None
    assert [float(rows[number]["sigma_rad"]) for number in (3, 59)] == pytest.approx(predicted.sigma_rad, abs=1e-6)
    assert rows[2]["sigma_rad"] == ""


@pytest.mark.slow
@pytest.mark.parametrize("fit_to", ["others", "both"])
def test_a_test_drive_gets_the_network_that_was_not_fitted_to_it(folder: Path, fit_to: str) -> None:
    tested = write_two_test_drives(folder)
    write_params(folder, {"fit_to": fit_to}, epochs=1, seeds=[0, 7])
    trained, evaluated = run_train(folder), run_evaluate(folder)
    own, val = (["2026_01_01_drive_0001"], ["2026_01_02_drive_0001"]) if fit_to == "both" else ([], [])
    result = json.loads((evaluated / "metrics.json").read_text())
    assert result["drives"] == {"train": own + tested[::-1], "val": val, "test": tested}
    for split in [split for split, names in result["drives"].items() if names]:  # each drive once
        assert result[split]["frames"] == len(result["drives"][split]) * (60 - 3)
    for seed in ("", "seed-7/"):
        rows = read(evaluated / f"{seed}predictions.csv")
        for drive in tested:
            model = predict.load(trained / f"{seed}fold-{drive}")
            assert model.fold == drive
            with graph_file.open_graphs(folder / f"graphs/semantic/{drive}.h5") as graphs:
                angles = model.predict(graphs)
            assert [row["predicted_rad"] for row in rows if row["drive"] == drive] == [_text(angle) for angle in angles]
    with pytest.raises(InputError, match="fold-2026_01_01_drive_0002, fold-2026"):
        predict.load(trained)
    report.main(folder, folder / "report", folder / "params.yaml")
    assert len(list((folder / "report/learning").iterdir())) == 4


def _text(angle: float) -> str:
    return "" if np.isnan(angle) else f"{angle:.6f}"


def test_files_of_one_model_repeat_and_agree(folder: Path) -> None:
    """predictions.csv has each frame; metrics and structure.json agree with it."""
    write_params(folder, {"equivariant": False}, epochs=1)
    run_train(folder)
    evaluated = run_evaluate(folder)
    first = {path.name: path.read_bytes() for path in evaluated.iterdir()}
    run_evaluate(folder)
    assert first == {path.name: path.read_bytes() for path in evaluated.iterdir()}
    assert set(first) == {"metrics.json", "predictions.csv", "structure.json", "index.json"}
    result, rows = json.loads(first["metrics.json"]), read(evaluated / "predictions.csv")
    assert not any("ms_per" in key for key in result)  # artefacts hold no times
    assert [row["frame"] for row in rows] == [str(number) for number in range(60)]
    assert [row["predicted_rad"] == "" for row in rows] == [number < 3 for number in range(60)]
    error = np.array([float(row["predicted_rad"]) - float(row["steering_rad"]) for row in rows[3:]])
    assert result["test"]["mse_rad2"] == pytest.approx(float((error**2).mean()), rel=1e-3)

    sharpest = int(max(rows, key=lambda row: abs(float(row["steering_rad"])))["frame"])
    graph = json.loads(first["structure.json"])["2026_01_03_drive_0001"]
    assert graph["frame"] == sharpest
    with graph_file.open_graphs(folder / "graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
        arrays = graph_file.collate([(graphs, sharpest, sharpest + 1)])
    np.testing.assert_allclose(graph["xyz_m"], arrays["xyz"], atol=6e-4)
    assert graph["cls"] == arrays["cls"].tolist()
    assert 2 * len(graph["edges"]) == len(arrays["indices"])


def test_the_memory_of_the_bootstrap_is_bounded_by_the_params(folder: Path) -> None:
    params = folder / "params.yaml"
    params.write_text(params.read_text().replace("bootstrap_samples: 2000", "bootstrap_samples: 1000000000"))
    with pytest.raises(InputError, match="bootstrap_samples"):
        run_evaluate(folder)


@pytest.mark.parametrize("name", ["/etc", "../model", ""])
def test_a_name_that_leaves_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="expected at most 100 letters"):
        evaluate.main(name, out=tmp_path / "data/evaluate")
    assert not [*tmp_path.iterdir()]
