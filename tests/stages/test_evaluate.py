import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pipeline.base import imports, store
from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint
from pipeline.train import frames, predict
from stages import report
from tests import artefacts
from tests.small_model import SPLITS, run_evaluate, run_train, write_params, write_two_test_drives


@pytest.mark.slow
def test_figures_are_means_over_seeds(folder: Path) -> None:
    write_params(folder, seeds=[0, 7], epochs=2)
    made = run_train(folder)
    first, second = (torch.load(made / path, weights_only=True)["net"] for path in ("best.pt", "seed-7/best.pt"))
    assert any(not torch.equal(first[name], second[name]) for name in first)
    judged = run_evaluate(folder)
    both = json.loads((judged / "metrics.json").read_text())["test"]
    report.main(folder, folder / "report", folder / "params.yaml")
    assert "Means over 2 seeds" in (folder / "report/table.md").read_text()

    alone = []
    for seed in (0, 7):
        write_params(folder, seeds=[seed], epochs=2)
        run_train(folder)
        alone.append(json.loads((run_evaluate(folder) / "metrics.json").read_text())["test"])
        own = judged / ("predictions.csv" if seed == 0 else "seed-7/predictions.csv")
        assert own.exists()
    for key in ("mse_rad2", "nmse", "mae_deg"):
        assert both[key] == pytest.approx((alone[0][key] + alone[1][key]) / 2)
    assert both["nmse_std"] == pytest.approx(abs(alone[0]["nmse"] - alone[1]["nmse"]) / np.sqrt(2))
    assert alone[0]["nmse_std"] is None


@pytest.mark.slow
@pytest.mark.parametrize("fit_to", ["others", "both"])
def test_a_test_drive_is_judged_by_the_network_that_has_not_seen_it(folder: Path, fit_to: str) -> None:
    tested = write_two_test_drives(folder)
    write_params(folder, {"fit_to": fit_to}, epochs=1, seeds=[0, 7])
    made, judged = run_train(folder), run_evaluate(folder)
    networks = sorted(str(path.parent.relative_to(made)) for path in made.rglob("best.pt"))
    assert networks == sorted(f"{seed}fold-{drive}" for seed in ("", "seed-7/") for drive in tested)
    own, val = (["2026_01_01_drive_0001"], ["2026_01_02_drive_0001"]) if fit_to == "both" else ([], [])
    result = json.loads((judged / "metrics.json").read_text())
    assert result["drives"] == {"train": own + tested[::-1], "val": val, "test": tested}
    for split in [split for split, names in result["drives"].items() if names]:  # each drive once
        assert result[split]["frames"] == len(result["drives"][split]) * (60 - 3)
    assert (result["val"] is None) == (fit_to == "others")
    assert sorted(result["test"]["by_drive"]) == tested
    assert result["test"]["frames"] == 2 * (60 - 3)
    for seed in ("", "seed-7/"):
        with (judged / f"{seed}predictions.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        for drive in tested:
            model = predict.load(made / f"{seed}fold-{drive}")
            assert model.fold == drive
            with frames.open_graphs(folder / f"graphs/semantic/{drive}.h5") as graphs:
                angles = model.predict(graphs)
            written = [row["predicted_rad"] for row in rows if row["drive"] == drive]
            assert written == ["" if np.isnan(angle) else f"{angle:.6f}" for angle in angles]
    with pytest.raises(InputError, match=r"net is not a trained model.*: fold-2026_01_01_drive_0002, fold-2026"):
        predict.load(made)
    out = folder / "report"
    report.main(folder, out, folder / "params.yaml")
    assert len(list((out / "learning").iterdir())) == 4
    assert "<h2>Learning curves</h2>" in (out / "index.html").read_text()
    assert f"| {fit_to} |" in (out / "table.md").read_text()


@pytest.mark.slow
def test_a_drive_that_cannot_be_judged_is_named_and_still_teaches(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short, *tested = ["2026_01_03_drive_0001", *write_two_test_drives(folder)]
    store.write_index(folder / "graphs/semantic", {**dict.fromkeys([*tested, short], "test")})
    straight = np.zeros(60)
    artefacts.write_labels(folder / f"labels/{short}.h5", short, straight, np.arange(60))
    write_params(folder, {"fit_to": "others"}, epochs=1)
    made, judged = run_train(folder), run_evaluate(folder)
    said = capsys.readouterr().out
    assert f"not judged: {folder / 'labels'}: every valid label of {short} is 0" in said
    assert sorted(path.parent.name for path in made.rglob("best.pt")) == [f"fold-{drive}" for drive in tested]
    result = json.loads((judged / "metrics.json").read_text())
    assert result["drives"]["test"] == tested
    assert short in result["drives"]["train"]
    for drive in tested:
        artefacts.write_labels(folder / f"labels/{drive}.h5", drive, straight, np.arange(60))
    with pytest.raises(InputError, match=r"every valid label of .* is 0"):
        run_train(folder)


def test_a_checkpoint_for_other_inputs_is_refused(folder: Path) -> None:
    run_train(folder)
    artefacts.write_dataset(folder, SPLITS, frames=60, points=60, write=artefacts.write_images)
    with pytest.raises(
        InputError, match=r"model net expects kNN graphs, but .*\.h5 holds images of 32 x 48 .*single-item train@net"
    ):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


def test_a_checkpoint_of_another_network_is_refused(folder: Path) -> None:
    made = run_train(folder)
    config = json.loads((made / "config.json").read_text())
    store.write_json(made / "config.json", config | {"model": config["model"] | {"alpha": 1.0}})
    with pytest.raises(InputError, match=r"best\.pt is of model net, seed 0, .*config.* --single-item train@net"):
        run_evaluate(folder)
    content = torch.load(made / "best.pt", weights_only=True)
    content["model"]["features"] = 9
    checkpoint.write(made / "best.pt", content)
    with pytest.raises(InputError, match=r"best\.pt does not fit .* dvc repro --force --single-item train@net"):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


def test_a_checkpoint_of_another_run_is_refused(folder: Path) -> None:
    """Of the same model, seed and drives; beside its own config.json, an older one or none, it is as good as any."""
    write_params(folder, learning_rate=0.02, epochs=1)
    made = run_train(folder)
    best, config = (made / "best.pt").read_bytes(), json.loads((made / "config.json").read_text())
    write_params(folder, epochs=1)
    run_train(folder)
    (made / "best.pt").write_bytes(best)
    with pytest.raises(InputError, match=r"net/best\.pt is not the one that .*/config\.json was .*-item train@net$"):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()
    older = {key: value for key, value in config.items() if key != "best_sha256"}
    for beside in (config, older):
        store.write_json(made / "config.json", beside)
        assert predict.load(made).name == "net"
    (made / "config.json").unlink()
    assert predict.load(made).name == "net"


def test_a_checkpoint_of_another_model_is_refused(folder: Path) -> None:
    made = run_train(folder)
    config = json.loads((made / "config.json").read_text())
    del config["best_sha256"]
    store.write_json(made / "config.json", config)
    content = torch.load(made / "best.pt", weights_only=True)
    checkpoint.write(made / "best.pt", content | {"name": "other"})
    with pytest.raises(InputError, match=r"best\.pt is of model other, seed 0, .*Train it again"):
        run_evaluate(folder)
    (made / "best.pt").write_bytes((made / "last.pt").read_bytes()[:-100])
    with pytest.raises(InputError, match=r"best\.pt is cut short.* dvc repro --force --single-item train@net"):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


def test_evaluate_and_report_are_byte_identical_when_run_twice(folder: Path) -> None:
    run_train(folder)

    def made() -> dict[str, bytes]:
        run_evaluate(folder)
        report.main(folder, folder / "report", folder / "params.yaml")
        files = [*(folder / "evaluate").rglob("*"), *(folder / "report").rglob("*")]
        return {str(path): path.read_bytes() for path in files if path.is_file()}

    first = made()
    assert first == made()
    assert {Path(name).name for name in first} >= {
        "metrics.json",
        "predictions.csv",
        "steering.png",
        "table.md",
        "table.csv",
    }


def test_predictions_csv_covers_every_frame(folder: Path) -> None:
    run_train(folder)
    lines = (run_evaluate(folder) / "predictions.csv").read_text().splitlines()
    assert lines[0] == "drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid,onset"
    rows = [line.split(",") for line in lines[1:]]
    assert [row[1] for row in rows] == [str(number) for number in range(60)]
    assert [row[5] == "" for row in rows] == [number < 3 for number in range(60)]
    error = np.array([float(row[5]) - float(row[4]) for row in rows[3:]])
    result = json.loads((folder / "evaluate/net/metrics.json").read_text())
    assert result["test"]["mse_rad2"] == pytest.approx(float((error**2).mean()), rel=1e-3)


def test_structure_and_neurons_are_those_of_the_sharpest_bend(folder: Path) -> None:
    write_params(folder, {"equivariant": False}, epochs=1)
    made, judged = run_train(folder), run_evaluate(folder)
    with (judged / "predictions.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    sharpest = max(rows, key=lambda row: abs(float(row["steering_rad"])))
    shown = json.loads((judged / "structure.json").read_text())["2026_01_03_drive_0001"]
    assert shown["frame"] == int(sharpest["frame"])
    with frames.open_graphs(folder / "graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
        arrays = graphs.read(shown["frame"], shown["frame"] + 1)
    np.testing.assert_allclose(shown["xyz_m"], arrays["xyz"], atol=6e-4)
    assert shown["cls"] == arrays["cls"].tolist()
    assert 2 * len(shown["edges"]) == len(arrays["indices"])

    told = json.loads((judged / "neurons.json").read_text())
    wiring, activity = told["wiring"], np.array(told["activity"])
    assert activity.shape[1] == wiring["motor"] + wiring["command"] + wiring["inter"]
    assert int(sharpest["frame"]) in told["frame"]
    model = predict.load(made)
    said = {int(row["frame"]): row["predicted_rad"] for row in rows}
    scale, shift = (getattr(model.net.temporal, f"output_{name}").item() for name in ("scale", "shift"))
    answers = model.target.std_rad * (activity[:, 0] * scale + shift)  # what the motor neuron's state means
    np.testing.assert_allclose(answers, [float(said[number]) for number in told["frame"]], atol=1e-4)
    listeners = {target for _, target, _ in wiring["internal"] if target < wiring["motor"]}
    assert listeners == {0}


def test_a_network_without_wiring_has_no_neurons_to_show(folder: Path) -> None:
    write_params(folder, {"temporal": "lstm"}, epochs=1)
    run_train(folder)
    assert json.loads((run_evaluate(folder) / "neurons.json").read_text()) == {}


@pytest.mark.slow
def test_in_python_a_model_predicts_the_numbers_of_predictions_csv(folder: Path) -> None:
    write_params(folder, seeds=[0, 7], epochs=1)
    made, judged = run_train(folder), run_evaluate(folder)
    for own, trained in ((judged, made), (judged / "seed-7", str(made / "seed-7"))):
        with (own / "predictions.csv").open(newline="") as file:
            written = {int(row["frame"]): row["predicted_rad"] for row in csv.DictReader(file)}
        model = predict.load(trained)
        with frames.open_graphs(folder / "graphs/semantic/2026_01_03_drive_0001.h5") as graphs:
            every, some = model.predict(graphs), model.predict(graphs, [59, 2, 30])
        assert [("" if np.isnan(angle) else f"{angle:.6f}") for angle in every] == list(written.values())
        assert some == pytest.approx(every[[59, 2, 30]], abs=1e-6, nan_ok=True)
        assert np.isnan(some[1])


def test_report_names_models_that_are_not_here(folder: Path) -> None:
    run_train(folder)
    run_evaluate(folder)
    content = yaml.safe_load((folder / "params.yaml").read_text())
    content["models"]["other"] = content["models"]["net"]
    (folder / "params.yaml").write_text(yaml.safe_dump(content))
    report.main(folder, folder / "report", folder / "params.yaml")
    text = (folder / "report" / "table.md").read_text()
    assert "| net | " in text
    assert "dvc repro --pull --downstream train@other" in text
    assert len(re.findall(r"\| \*zero\* \|.*\| 1\.000 \|", text)) == 1
    with (folder / "report" / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["model"] for row in rows] == ["net", "zero", "train_mean", "persistence"]
    assert float(rows[0]["test_nmse_low"]) <= float(rows[0]["test_nmse_high"])
    assert rows[1]["test_nmse"] == "1.0"


def test_no_edit_of_judging_trains_and_no_edit_of_the_run_is_judged() -> None:
    trained_by, judged_by = (
        {str(path) for path in imports.import_closure(f"stages.{stage}")} for stage in ("train", "evaluate")
    )
    assert not {path for path in trained_by if path.startswith("pipeline/report")}
    assert not {path for path in judged_by if Path(path).stem in ("fit", "augment", "schedule")}
    assert {"pipeline/train/predict.py", "pipeline/train/windows.py"} <= trained_by & judged_by
