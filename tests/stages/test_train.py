import json
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.fitting import checkpoint
from pipeline.train import distributed, training, windows
from stages import report
from tests import artefacts
from tests.small_model import PARAMS, SPLITS, run_evaluate, run_train, write_params, write_two_test_drives


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
def test_killed_and_resumed_gives_the_bytes_of_an_undisturbed_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_train(folder)
    straight = made_by(folder)
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
    run_train(folder)
    assert made_by(folder) == straight
    assert not (folder / ".resume" / "train-net").exists()


@pytest.mark.slow
def test_killed_between_a_network_and_its_config_the_pair_is_refused_until_the_run_goes_on(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_train(folder)  # by hand, so that an earlier result is there, which DVC would have removed
    write_params(folder, learning_rate=0.02)
    with monkeypatch.context() as patch:
        patch.setattr(training, "write_curve", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run_train(folder)
    with pytest.raises(InputError, match=r"best\.pt is not the one that .*config\.json was written for"):
        run_evaluate(folder)
    run_train(folder)
    assert run_evaluate(folder)


@pytest.mark.slow
def test_a_killed_run_with_other_params_is_not_resumed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "write_curve", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
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


def made_by(folder: Path) -> dict[str, bytes]:
    """Return relative path → contents of what training and judging wrote, without the time that they took."""
    files = [path for stage in ("train", "evaluate") for path in (folder / stage).rglob("*") if path.is_file()]
    contents = {str(path.relative_to(folder)): path.read_bytes() for path in files}
    return {name: re.sub(rb'"encode_ms_per_frame": [\d.]+', b"", content) for name, content in contents.items()}


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
    report.main(folder, folder / "report", folder / "params.yaml")
    table = (folder / "report/table.md").read_text()
    assert "| *odometry* " in table


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


def on_two_machines(clones: list[Path]) -> list[tuple[int, str, str]]:
    """Train by a process each, started in clones of their own; return exit status, output and errors of each."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--nnodes=2", "--nproc-per-node=1"]
    place = ["--master-addr=127.0.0.1", f"--master-port={port}", "-m", "stages.train", "net"]
    processes = [
        subprocess.Popen(
            [*torchrun, f"--node-rank={rank}", *place], cwd=clone, env=os.environ | {"PYTHONPATH": str(clone)},
            text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        for rank, clone in enumerate(clones)
    ]  # fmt: skip
    outputs = [process.communicate(timeout=240) for process in processes]
    return [(process.returncode, *output) for process, output in zip(processes, outputs, strict=True)]


def cloned(folder: Path, to: Path) -> Path:
    """Make a clone of this code with a copy of the graphs and labels in `folder`."""
    for name in ("pipeline", "models", "stages"):
        shutil.copytree(PARAMS.parent / name, to / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("graphs", "labels"):
        shutil.copytree(folder / name, to / "data" / name)
    shutil.copy(folder / "params.yaml", to)
    return to


@pytest.mark.slow
def test_two_machines_with_clones_of_their_own_train_as_one(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first alone writes, and after a kill it tells the second where to go on."""
    write_params(folder, precision="float64", epochs=2, run_windows=24, batch_runs=2)
    first, second = clones = [cloned(folder, tmp_path / name) for name in ("first", "second")]
    write = checkpoint.write

    def killed(path: Path, content: dict[str, object]) -> None:
        write(path, content)
        raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint, "write", killed)
    with pytest.raises(KeyboardInterrupt):
        run_train(folder)
    monkeypatch.setattr(checkpoint, "write", write)
    shutil.copytree(folder / ".resume", first / "data/.resume")
    (status, said, _), (other_status, other_said, errors) = on_two_machines(clones)
    assert (status, other_status, other_said) == (0, 0, ""), errors
    assert "1 of 2 epochs kept from the run before" in said
    alone = torch.load(run_train(folder) / "last.pt", weights_only=True)
    two = torch.load(first / "data/train/net/last.pt", weights_only=True)
    for name, tensor in alone["net"].items():
        torch.testing.assert_close(two["net"][name], tensor, rtol=1e-7, atol=1e-9)
    assert not list((first / "data/.resume").iterdir())
    assert {path.name for path in (second / "data").iterdir()} == {"graphs", "labels"}


@pytest.mark.slow
def test_a_clone_that_is_behind_is_refused(folder: Path, tmp_path: Path) -> None:
    clones = [cloned(folder, tmp_path / name) for name in ("first", "second")]
    with (clones[1] / "pipeline/train/fit.py").open("a") as code:
        code.write("# an edit\n")
    write_params(folder, batch_runs=2)
    for clone in clones:
        shutil.copy(folder / "params.yaml", clone)
    for status, _, errors in on_two_machines(clones):
        assert status == 1
        assert "error: net: the processes have not all the same code, settings, graphs and labels: bring" in errors


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
    report.main(tmp_path, tmp_path / "report", tmp_path / "params.yaml")
    assert "– |" in (tmp_path / "report/table.md").read_text()


@pytest.mark.slow
def test_a_killed_run_is_not_resumed_on_another_split(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was trained on must not become validation: the files are the same, only their roles differ."""
    keys = []
    for splits in (SPLITS, {**SPLITS, "2026_01_01_drive_0003": "val"}):
        store.write_index(folder / "graphs/semantic", splits)
        with monkeypatch.context() as patch:
            patch.setattr(training, "write_curve", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
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
