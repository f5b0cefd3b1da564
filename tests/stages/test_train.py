import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pipeline.base import provenance, store
from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint
from pipeline.train import distributed, fit, frames, predict, windows
from stages import evaluate, report, train
from tests import artefacts

PARAMS = Path(__file__).resolve().parents[2] / "params.yaml"
SPLITS = {
    "2026_01_01_drive_0001": "train", "2026_01_01_drive_0002": "train", "2026_01_01_drive_0003": "train",
    "2026_01_02_drive_0001": "val", "2026_01_03_drive_0001": "test",
}  # fmt: skip


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset")
    artefacts.write_dataset(folder, SPLITS, frames=60, points=80)
    return folder


@pytest.fixture
def folder(dataset: Path, tmp_path: Path) -> Path:
    shutil.copytree(dataset, tmp_path / "data")
    write_params(tmp_path / "data")
    return tmp_path / "data"


def write_params(folder: Path, model: dict[str, object] | None = None, **settings: object) -> None:
    content = yaml.safe_load(PARAMS.read_text())
    line = {"spatial": "gnn", **(model or {})}
    knobs = {"layers": [16, 16], "semantics": 1.0}
    means_nothing = {"cnn": {"layers", "semantics"}, "pointnet2": {"layers"}}.get(str(line["spatial"]), set())
    small = {"input": "semantic", "temporal": "ncp", "window": 4, "features": 8, "equivariant": True}
    small |= {knob: value for knob, value in knobs.items() if knob not in means_nothing}
    content["models"] = {"net": small | line}
    content["train"] |= {"epochs": 3, "learning_rate": 0.01, **settings}
    (folder / "params.yaml").write_text(yaml.safe_dump(content))


def run_train(folder: Path) -> Path:
    return train.main("net", folder / "graphs", folder / "labels", folder / "train", folder / "params.yaml")


def run_evaluate(folder: Path) -> Path:
    return evaluate.main(
        "net", folder / "train", folder / "graphs", folder / "labels", folder / "evaluate", folder / "params.yaml"
    )


@pytest.mark.slow
@pytest.mark.parametrize("temporal", ["ncp", "lstm"])
def test_a_trained_model_reads_the_bend(folder: Path, temporal: str) -> None:
    write_params(folder, {"temporal": temporal}, epochs=14)
    run_train(folder)
    result = json.loads((run_evaluate(folder) / "metrics.json").read_text())
    assert result["test"]["nmse"] < 0.35
    assert result["test"]["nmse_ci95"][0] <= result["test"]["nmse"] <= result["test"]["nmse_ci95"][1]
    assert result["drives"]["test"] == ["2026_01_03_drive_0001"]
    assert result["test"]["frames"] == 60 - 3
    assert sum(row["frames"] for row in result["test"]["by_curvature"]) == 57


@pytest.mark.slow
def test_killed_and_resumed_gives_the_weights_of_an_undisturbed_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    straight = torch.load(run_train(folder) / "last.pt", weights_only=True)
    shutil.rmtree(folder / "train")
    write = checkpoint.write

    def killed(path: Path, content: dict[str, object]) -> None:
        write(path, content)
        if content["epoch"] == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint, "write", killed)
    with pytest.raises(KeyboardInterrupt):
        run_train(folder)
    assert not (folder / "train").exists()
    monkeypatch.setattr(checkpoint, "write", write)
    resumed = torch.load(run_train(folder) / "last.pt", weights_only=True)
    assert resumed["curve"] == straight["curve"]
    assert all(torch.equal(resumed["net"][name], tensor) for name, tensor in straight["net"].items())
    assert not (folder / ".resume" / "train-net").exists()


@pytest.mark.slow
def test_a_killed_run_with_other_params_is_not_resumed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "write_curve", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        run_train(folder)
    monkeypatch.undo()
    write_params(folder, learning_rate=0.02)
    rates = [row["learning_rate"] for row in torch.load(run_train(folder) / "last.pt", weights_only=True)["curve"]]
    assert max(rates) > 0.01


def test_checkpoints_say_what_they_are(folder: Path) -> None:
    made = run_train(folder)
    best = torch.load(made / "best.pt", weights_only=True)
    assert best["model"]["temporal"] == "ncp"
    assert best["splits"] == SPLITS
    assert set(best["target"]) == {"mean_rad", "std_rad", "wheelbase_m", "min_speed_mps"}
    config = json.loads((made / "config.json").read_text())
    assert config["best_epoch"] == best["epoch"] <= config["epochs"] == 3
    curve = (made / "curve.csv").read_text().splitlines()
    assert curve[0] == "epoch,learning_rate,train_loss,val_mse_rad2,val_nmse"
    assert len(curve) == 4
    judged = [float(row.split(",")[-1]) for row in curve[1:]]
    assert best["epoch"] == 1 + int(np.argmin(judged))


@pytest.mark.slow
def test_without_validation_drives_the_last_epoch_counts(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    splits = {drive: split for drive, split in SPLITS.items() if split != "val"}
    store.write_index(folder / "graphs/semantic", splits)
    made = run_train(folder)
    assert "no validation drives, so no early stopping" in capsys.readouterr().out
    assert json.loads((made / "config.json").read_text())["best_epoch"] == 3
    result = json.loads((run_evaluate(folder) / "metrics.json").read_text())
    assert result["val"] is None


@pytest.mark.slow
def test_figures_are_means_over_seeds(folder: Path) -> None:
    write_params(folder, seeds=[0, 7], epochs=2)
    made = run_train(folder)
    first, second = (torch.load(made / path, weights_only=True)["net"] for path in ("best.pt", "seed-7/best.pt"))
    assert any(not torch.equal(first[name], second[name]) for name in first)
    judged = run_evaluate(folder)
    both = json.loads((judged / "metrics.json").read_text())["test"]
    report.main(folder / "evaluate", folder / "report", folder / "params.yaml")
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


def write_two_test_drives(folder: Path) -> list[str]:
    """Make two of the training drives test drives; return the test drives."""
    tested = ["2026_01_01_drive_0002", "2026_01_01_drive_0003"]
    splits = {**SPLITS, **dict.fromkeys(tested, "test")}
    del splits["2026_01_03_drive_0001"]
    store.write_index(folder / "graphs/semantic", splits)
    return tested


def made_by(folder: Path) -> dict[str, bytes]:
    """Return relative path → contents of what training and judging wrote, without the time that they took."""
    files = [path for stage in ("train", "evaluate") for path in (folder / stage).rglob("*") if path.is_file()]
    contents = {str(path.relative_to(folder)): path.read_bytes() for path in files}
    return {name: re.sub(rb'"encode_ms_per_frame": [\d.]+', b"", content) for name, content in contents.items()}


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
    assert result["encode_ms_per_frame"] > 0
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
    report.main(folder / "evaluate", out, folder / "params.yaml", folder / "scores", folder / "train")
    assert len(list((out / "learning").iterdir())) == 4
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


@pytest.mark.slow
def test_any_number_of_workers_writes_the_same_bytes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_two_test_drives(folder)
    write_params(folder, {"fit_to": "others"}, epochs=2)
    made = []
    for workers in ("1", "2"):
        monkeypatch.setenv("STEER_WORKERS", workers)
        run_train(folder)
        run_evaluate(folder)
        made.append(made_by(folder))
        shutil.rmtree(folder / "train")
    assert made[0] == made[1]
    assert not (folder / ".resume/train-net").exists()


@pytest.mark.slow
def test_runs_side_by_side_go_on_after_a_kill(folder: Path, tmp_path: Path) -> None:
    write_params(folder, seeds=[0, 7], epochs=40)
    arguments = [f"--{key}={folder / key}" for key in ("graphs", "labels")] + [f"--params={folder / 'params.yaml'}"]
    command = [sys.executable, "-m", "stages.train", "net", *arguments, f"--out={folder / 'train'}"]
    environment = {**os.environ, "STEER_WORKERS": "2"}
    with subprocess.Popen(command, cwd=PARAMS.parent, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        said = [next(line for line in process.stdout if "epoch 2/40" in line)]
        process.kill()
        said += process.stdout  # until the workers have ended, too
    write_params(folder, seeds=[0, 7], epochs=40)
    kept = {path.name for path in (folder / ".resume/train-net").glob("*.pt")}
    assert kept
    assert not (folder / "train").exists()
    done = subprocess.run(command, cwd=PARAMS.parent, env=environment, capture_output=True, text=True, check=True)
    assert "of 40 epochs kept from the run before" in done.stdout
    assert all(re.match(r"net seed [07]: ", line) for line in done.stdout.splitlines())
    assert (folder / "train/net/seed-7/best.pt").is_file()


@pytest.mark.slow
def test_with_motion_and_a_horizon_the_measured_angle_is_where_learning_starts(folder: Path) -> None:
    for drive in SPLITS:
        with store.DriveReader(folder / f"labels/{drive}.h5", stage="labels") as truth:
            artefacts.add_motion(folder / f"graphs/semantic/{drive}.h5", "visual", truth["steering_rad"])
    write_params(folder, {"motion": "visual", "horizon": 5}, epochs=12, average=0.0)
    made, judged = run_train(folder), run_evaluate(folder)
    result = json.loads((judged / "metrics.json").read_text())
    test = result["test"]
    assert test["frames"] == 60 - 3 - 5
    assert result["line"]["horizon"] == 5
    assert test["baselines"]["odometry"]["nmse"] == pytest.approx(test["baselines"]["persistence"]["nmse"], rel=1e-3)
    assert test["nmse"] < 0.8 * test["baselines"]["odometry"]["nmse"]
    (drive,) = windows.read_drives(
        folder / "graphs/semantic", folder / "labels", ["2026_01_03_drive_0001"], 4, 5, "visual"
    )
    target = torch.load(made / "best.pt", weights_only=True)["target"]
    assert target["std_rad"] != pytest.approx(drive.steering_rad[drive.valid].std(), rel=0.05)
    rows = [line.split(",") for line in (judged / "predictions.csv").read_text().splitlines()[1:]]
    assert [row[6] for row in rows] == ["1"] * 55 + ["0"] * 5
    report.main(folder / "evaluate", folder / "report", folder / "params.yaml")
    table = (folder / "report/table.md").read_text()
    assert "| *odometry* |" in table
    assert "5 frames ahead" in table


@pytest.mark.slow
def test_roads_are_the_first_training_drives(folder: Path) -> None:
    write_params(folder, {"roads": 2}, epochs=1)
    store.write_index(folder / "graphs/semantic", dict(reversed(SPLITS.items())))
    run_train(folder)
    assert torch.load(folder / "train/net/best.pt", weights_only=True)["model"]["roads"] == 2
    result = json.loads((run_evaluate(folder) / "metrics.json").read_text())
    assert result["drives"]["train"] == ["2026_01_01_drive_0003", "2026_01_01_drive_0002"]


@pytest.mark.slow
def test_two_processes_train_as_one(folder: Path) -> None:
    """torchrun's processes share each step's runs: in float64 the losses are those of one process, to rounding."""
    epochs, seed = 4, 0
    write_params(folder, precision="float64", epochs=epochs, run_windows=24, batch_runs=2)
    arguments = [f"--{key}={folder / key}" for key in ("graphs", "labels")] + [f"--params={folder / 'params.yaml'}"]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]
    command = [*torchrun, "-m", "stages.train", "net", *arguments, f"--out={folder / 'two'}"]
    done = subprocess.run(command, cwd=PARAMS.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("epoch 1/4") == 1  # one of them speaks
    alone = torch.load(run_train(folder) / "last.pt", weights_only=True)
    two = torch.load(folder / "two/net/last.pt", weights_only=True)
    assert two["net"]["spatial.layers.0.weight"].dtype == torch.float64
    for of_two, of_one in zip(two["curve"], alone["curve"], strict=True):
        assert of_two["train_loss"] == pytest.approx(of_one["train_loss"], rel=1e-9)
        assert of_two["val_mse_rad2"] == pytest.approx(of_one["val_mse_rad2"], rel=1e-9)
    for name, tensor in alone["net"].items():
        torch.testing.assert_close(two["net"][name], tensor, rtol=1e-7, atol=1e-9)
    assert not (folder / ".resume" / "two-net").exists()
    # Some steps had one run only: a process without a run took part, and did not count.
    drives = windows.read_drives(folder / "graphs/semantic", folder / "labels", store.of_split(SPLITS, "train"), 4)
    spans = [
        len(windows.random_spans(drives, 4, 24, np.random.default_rng([seed, epoch]))) for epoch in range(1, epochs + 1)
    ]
    assert any(count % 2 for count in spans)


def test_more_processes_than_runs_in_a_step_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def three() -> Iterator[tuple[distributed.World, torch.device]]:
        yield distributed.World(1, 3), torch.device("cpu")

    monkeypatch.setattr(distributed, "joined", three)
    with pytest.raises(InputError, match=r"train.batch_runs = 2: .* cannot be spread over 3 processes"):
        run_train(folder)
    assert not (folder / "train").exists()


@pytest.mark.slow
def test_bfloat16_products_train_nearly_the_same(folder: Path) -> None:
    losses = {}
    for precision in ("float32", "bfloat16"):
        write_params(folder, precision=precision)
        whole = torch.load(run_train(folder) / "last.pt", weights_only=True)
        losses[precision] = [row["train_loss"] for row in whole["curve"]]
        assert all(tensor.dtype in (torch.float32, torch.int64) for tensor in whole["net"].values())
    assert losses["bfloat16"] != losses["float32"]
    assert losses["bfloat16"] == pytest.approx(losses["float32"], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("line", [{"spatial": "edgeconv", "cell": "eq4"}, {"spatial": "gatv2", "cell": "cfc"}], ids=str)
def test_other_networks_train_and_are_judged(folder: Path, line: dict[str, object]) -> None:
    write_params(folder, line, epochs=2)
    made = run_train(folder)
    whole = torch.load(made / "best.pt", weights_only=True)
    assert line.items() <= whole["model"].items()
    assert all(weight.isfinite().all() for weight in whole["net"].values())
    assert json.loads((run_evaluate(folder) / "metrics.json").read_text())["test"]["mse_rad2"] > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("write", "line", "epochs"),
    [
        (artefacts.write_sets, {"spatial": "pointnet2", "width": 0.125, "equivariant": True}, 4),
        (artefacts.write_images, {"spatial": "cnn", "alpha": 5.0, "features": 32, "temporal": "lstm"}, 10),
    ],
)
def test_sets_and_images_go_the_same_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Callable[..., None], line: dict[str, object], epochs: int
) -> None:
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=60, write=write)
    write_params(tmp_path, line, epochs=epochs, average=0.0)
    run_train(tmp_path)
    config = json.loads((tmp_path / "train/net/config.json").read_text())
    count = 3 * 60
    if "alpha" in line:
        assert (
            f"weighted by alpha 5, {count} frames count as {config['effective_frames']:.0f}" in capsys.readouterr().out
        )
        assert 100 < config["effective_frames"] < count
    else:
        assert config["effective_frames"] == pytest.approx(count)
    result = json.loads((run_evaluate(tmp_path) / "metrics.json").read_text())
    assert result["test"]["nmse"] < 0.5
    assert result["edges_per_frame"] is None
    report.main(tmp_path / "evaluate", tmp_path / "report", tmp_path / "params.yaml")
    assert "| none |" in (tmp_path / "report/table.md").read_text()


def test_a_checkpoint_for_other_inputs_is_refused(folder: Path) -> None:
    run_train(folder)
    artefacts.write_dataset(folder, SPLITS, frames=60, points=60, write=artefacts.write_images)
    with pytest.raises(
        InputError, match=r"model net expects kNN graphs, but .*\.h5 holds images of 32 x 48 .*force train@net"
    ):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


@pytest.mark.slow
def test_a_killed_run_is_not_resumed_on_another_split(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was trained on must not become validation: the files are the same, only their roles differ."""
    keys = []
    for splits in (SPLITS, {**SPLITS, "2026_01_01_drive_0003": "val"}):
        store.write_index(folder / "graphs/semantic", splits)
        with monkeypatch.context() as patch:
            patch.setattr(fit, "write_curve", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                run_train(folder)
        keys.append({path.name for path in (folder / ".resume/train-net").glob("*.pt")})
    assert len(keys[0]) == 1
    assert len(keys[1]) == 2


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ({"spatial": "cnnn"}, r"models\.net.*spatial.*cnnn.*gnn"),
        ({"spatial": "cnn"}, r"models\.net.*cnn.* images.*semantic holds kNN graphs"),
        ({"spatial": "pointnet2"}, r"models\.net.*pointnet2.* points .*holds kNN graphs"),
        ({"temporal": "gru"}, r"models\.net.*temporal.*gru.*(ncp.*lstm|lstm.*ncp)"),
        ({"temporal": "lstm", "cell": "eq4"}, r"models\.net.*cell.*eq4.*lstm.*leave it out"),
        ({"window": 61}, "no window of 61 consecutive frames"),
        ({"horizon": 60}, "with a valid label 60 frames after its end"),
        ({"motion": "lidar"}, r"semantic/.*\.h5 carries no motion: lidar"),
        ({"roads": 4}, r"models\.net: roads = 4: there are 3 training drives"),
        ({"fit_to": "others"}, r"models\.net: fit_to = 'others': 2026_01_03_drive_0001 is the only test drive"),
        ({"fit_to": "others", "roads": 2}, r"models\.net: roads counts training drives"),
    ],
)
def test_impossible_models_are_refused_before_anything_is_written(
    folder: Path, line: dict[str, object], message: str
) -> None:
    write_params(folder, line)
    with pytest.raises(InputError, match=message):
        run_train(folder)
    assert not (folder / "train").exists()


def test_a_checkpoint_of_another_network_is_refused(folder: Path) -> None:
    made = run_train(folder)
    config = json.loads((made / "config.json").read_text())
    store.write_json(made / "config.json", config | {"model": config["model"] | {"alpha": 1.0}})
    with pytest.raises(InputError, match=r"best\.pt is of model net, seed 0, .*config.* --force train@net"):
        run_evaluate(folder)
    content = torch.load(made / "best.pt", weights_only=True)
    content["model"]["features"] = 9
    checkpoint.write(made / "best.pt", content)
    with pytest.raises(InputError, match=r"best\.pt does not fit .* dvc repro --force train@net"):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


def test_a_checkpoint_of_another_model_is_refused(folder: Path) -> None:
    made = run_train(folder)
    content = torch.load(made / "best.pt", weights_only=True)
    checkpoint.write(made / "best.pt", content | {"name": "other"})
    with pytest.raises(InputError, match=r"best\.pt is of model other, seed 0, .*Train it again"):
        run_evaluate(folder)
    (made / "best.pt").write_bytes((made / "last.pt").read_bytes()[:-100])
    with pytest.raises(InputError, match=r"best\.pt is cut short.* dvc repro --force train@net"):
        run_evaluate(folder)
    assert not (folder / "evaluate").exists()


def test_evaluate_and_report_are_byte_identical_when_run_twice(folder: Path) -> None:
    run_train(folder)

    def made() -> dict[str, bytes]:
        run_evaluate(folder)
        report.main(folder / "evaluate", folder / "report", folder / "params.yaml")
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
    assert lines[0] == "drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid"
    rows = [line.split(",") for line in lines[1:]]
    assert [row[1] for row in rows] == [str(number) for number in range(60)]
    assert [row[5] == "" for row in rows] == [number < 3 for number in range(60)]
    error = np.array([float(row[5]) - float(row[4]) for row in rows[3:]])
    result = json.loads((folder / "evaluate/net/metrics.json").read_text())
    assert result["test"]["mse_rad2"] == pytest.approx(float((error**2).mean()), rel=1e-3)


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
    report.main(folder / "evaluate", folder / "report", folder / "params.yaml")
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
        {str(path) for path in provenance.import_closure(f"stages.{stage}")} for stage in ("train", "evaluate")
    )
    assert not {path for path in trained_by if path.startswith("pipeline/report")}
    assert not {path for path in judged_by if Path(path).stem in ("fit", "augment", "schedule")}
    assert {"pipeline/train/predict.py", "pipeline/train/windows.py"} <= trained_by & judged_by
