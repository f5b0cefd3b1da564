"""Stage train: learning, resume, mirror pairs, torchrun."""

import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from pipeline.base import store
from pipeline.train import checkpoint, distributed
from pipeline.train.labelled_drive import read_drives
from pipeline.train.runs import Run
from pipeline.train.training import networks_at_once
from stages import train
from tests import artefacts
from tests.small_model import PARAMS, SPLITS, run_evaluate, run_train, write_params

TEST = "2026_01_03_drive_0001"
EPOCHS = 12


@pytest.fixture(scope="module")
def trained(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a trained and evaluated gnn-ncp. Read only."""
    folder = tmp_path_factory.mktemp("trained") / "data"
    shutil.copytree(dataset, folder)
    write_params(folder, epochs=EPOCHS)
    run_train(folder)
    run_evaluate(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Return relative path → bytes of the files of the stage train."""
    files = [path for path in (folder / "train").rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def load(path: Path) -> dict[str, object]:
    return torch.load(path, weights_only=True)


@contextmanager
def killed_after(monkeypatch: pytest.MonkeyPatch, epoch: int) -> Iterator[None]:
    """Interrupt training after the checkpoint of an epoch."""
    write = checkpoint.write

    def interrupt(path: Path, content: dict[str, object]) -> None:
        write(path, content)
        if content["epoch"] == epoch:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            yield


def test_a_trained_model_follows_the_bend(trained: Path) -> None:
    result = json.loads((trained / "evaluate/net/metrics.json").read_text())
    assert result["test"]["nmse"] < 0.35
    assert result["drives"]["test"] == [TEST]
    assert result["test"]["frames"] == 60 - 3
    best = load(trained / "train/net/best.pt")
    assert best["splits"] == SPLITS
    assert set(best["target"]) == {
        "mean_rad",
        "std_rad",
        "wheelbase_m",
        "min_speed_mps",
        "coefficients",
        "sigma_factor",
        "interval_95",
    }
    config = json.loads((trained / "train/net/config.json").read_text())
    assert config["best_epoch"] == best["epoch"] <= config["epochs"] == EPOCHS
    header, *rows = (trained / "train/net/curve.csv").read_text().splitlines()
    assert header == "epoch,learning_rate,train_loss,val_mse_rad2,val_nmse"
    assert len(rows) == EPOCHS
    nmse = [float(row.split(",")[-1]) for row in rows]
    smoothed = [np.mean(nmse[max(0, end - 3) : end]) for end in range(1, EPOCHS + 1)]
    assert best["epoch"] == 1 + int(np.argmin(smoothed))


def test_resumed_training_writes_the_same_bytes(folder: Path, trained: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_params(folder, epochs=EPOCHS)
    with killed_after(monkeypatch, EPOCHS - 2):
        run_train(folder)
    assert not (folder / "train").exists()
    run_train(folder)
    assert contents(folder) == contents(trained)
    assert list((folder / ".drives/train-net").iterdir()) == []


@pytest.mark.slow
def test_lstm_with_motion_and_horizon_beats_odometry(folder: Path) -> None:
    for drive in SPLITS:
        with store.DriveReader(folder / f"labels/{drive}.h5", stage="labels") as truth:
            artefacts.add_motion(folder / f"graphs/semantic/{drive}.h5", truth["steering_rad"])
    write_params(folder, {"temporal": "lstm", "motion": "visual", "horizon": 5}, epochs=EPOCHS, average=0.0)
    output, metrics = run_train(folder), run_evaluate(folder)
    test = json.loads((metrics / "metrics.json").read_text())["test"]
    assert test["frames"] == 60 - 3 - 5
    assert test["nmse"] < 0.8 * test["baselines"]["odometry"]["nmse"]
    (drive,) = read_drives(folder / "graphs/semantic", folder / "labels", [TEST], 4, horizon=5, motion="visual")
    assert load(output / "best.pt")["target"]["std_rad"] != pytest.approx(
        drive.steering_rad[drive.valid].std(), rel=0.05
    )
    rows = [line.split(",") for line in (metrics / "predictions.csv").read_text().splitlines()[1:]]
    assert [row[6] for row in rows] == ["1"] * 55 + ["0"] * 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("write", "line", "epochs", "nmse"),
    [
        (artefacts.write_graphs, {"spatial": "gatv2", "cell": "cfc"}, 1, 10),
        (artefacts.write_sets, {"spatial": "pointnet2", "width": 0.125}, 4, 0.5),
        (artefacts.write_images, {"spatial": "cnn", "alpha": 5.0, "features": 32, "temporal": "lstm"}, 10, 0.5),
    ],
)
def test_other_networks_and_inputs(
    tmp_path: Path, write: Callable[..., None], line: dict[str, object], epochs: int, nmse: float
) -> None:
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=60, write=write)
    write_params(tmp_path, line, epochs=epochs, average=0.0)
    best = load(run_train(tmp_path) / "best.pt")
    assert line.items() <= best["model"].items()
    assert all(weight.isfinite().all() for weight in best["net"].values())
    assert json.loads((run_evaluate(tmp_path) / "metrics.json").read_text())["test"]["nmse"] < nmse


def test_mirror_trains_the_same_on_a_mirrored_data_set(folder: Path) -> None:
    write_params(folder, {"equivariant": False}, mirror=True, precision="float64", epochs=2)
    curves = [load(run_train(folder) / "last.pt")["curve"]]
    for drive in SPLITS:
        with h5py.File(folder / f"graphs/semantic/{drive}.h5", "a") as file:
            file["xyz"][:, 0] = -file["xyz"][:, 0]
        with h5py.File(folder / f"labels/{drive}.h5", "a") as file:
            file["steering_rad"][:] = -file["steering_rad"][:]
    curves.append(load(run_train(folder) / "last.pt")["curve"])
    losses = [[row["train_loss"] for row in curve] for curve in curves]
    assert losses[0] == pytest.approx(losses[1], rel=1e-9)
    assert curves[0][1]["val_nmse"] != pytest.approx(curves[1][1]["val_nmse"], rel=1e-3)  # the network is not symmetric


def train_on_two_machines(clones: list[Path]) -> list[tuple[int, str, str]]:
    """Train with one process per clone; return exit status, output and errors of each."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--nnodes=2", "--nproc-per-node=1"]
    arguments = ["--master-addr=127.0.0.1", f"--master-port={port}", "-m", "stages.train", "net"]
    pipes = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    processes = [
        subprocess.Popen(
            [*torchrun, f"--node-rank={rank}", *arguments],
            cwd=clone,
            env=os.environ | {"PYTHONPATH": str(clone)},
            **pipes,
        )
        for rank, clone in enumerate(clones)
    ]
    outputs = [process.communicate(timeout=240) for process in processes]
    return [(process.returncode, *output) for process, output in zip(processes, outputs, strict=True)]


def clone(folder: Path, to: Path) -> Path:
    """Copy this code, dvc.yaml, and the graphs and labels in `folder`."""
    for name in ("pipeline", "models", "stages"):
        shutil.copytree(PARAMS.parent / name, to / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("graphs", "labels"):
        shutil.copytree(folder / name, to / "data" / name)
    shutil.copy(folder / "params.yaml", to)
    shutil.copy(PARAMS.parent / "dvc.yaml", to)
    return to


def test_networks_in_processes_of_one_gpu_equal_those_trained_one_after_the_other(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_params(folder, epochs=1, seeds=[0, 7])
    monkeypatch.setenv("STEER_WORKERS", "2")
    run_train(folder)  # in two processes
    expected = contents(folder)
    shutil.rmtree(folder / "train")
    gpu, found = torch.device("cuda", 0), {}

    def one_after_the_other(
        work: partial[None], jobs: Sequence[Run], *, workers: int, threads: int
    ) -> Iterator[tuple[Run, None]]:
        found.update(work.keywords, workers=workers)
        for run in jobs:
            yield run, work.func(run, job=work.keywords["job"])

    monkeypatch.setattr(distributed, "process_group", lambda: nullcontext((distributed.World(), gpu)))
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (20 * 10**9, 24 * 10**9))
    monkeypatch.setattr(train, "run_jobs", one_after_the_other)
    run_train(folder)
    assert contents(folder) == expected
    assert (found["workers"], found["device"], found["readers"]) == (2, gpu, 0)

    monkeypatch.setenv("STEER_WORKERS", "16")
    drive = next(iter(SPLITS))
    for free_gb, networks in (0.5, 1), (3.5, 3), (100, 16):
        monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _, free=int(free_gb * 1e9): (free, free))
        assert networks_at_once(found["job"], drive, gpu) == networks
    assert networks_at_once(found["job"], drive, torch.device("cpu")) is None
