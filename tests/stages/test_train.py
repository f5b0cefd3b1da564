"""Stage train on small graphs: it learns, resumes, and refuses data that teach nothing."""

import json
import shutil
from pathlib import Path
from unittest.mock import Mock

import h5py
import numpy as np
import pandas as pd
import pytest
import torch

from pipeline.base import checkpoint
from pipeline.base.errors import InputError
from pipeline.train.fit import Fit
from tests import artefacts, small_model
from tests.kitti_drive import contents
from tests.small_model import EDGES_M, SPLITS, TEST, run_evaluate, run_train, write_params


def load(path: Path) -> dict[str, object]:
    return torch.load(path, weights_only=True, map_location="cpu")


def nmse(folder: Path) -> float:
    """Evaluate the model, and return its nmse."""
    metrics = json.loads((run_evaluate(folder) / "metrics.json").read_text())
    return metrics["test"]["net"]["nmse"]


def test_a_trained_model_follows_the_bend_and_knows_its_settings(folder):
    write_params(folder, epochs=14, batch_spans=1)
    trained = run_train(folder)
    # With two seeds and the kernels of four processors, 0.26 ± 0.07. Always straight has 1.
    assert nmse(folder) < 0.55
    best = load(trained / "best.pt")
    labels = artefacts.LABELS["labels"] | {"ahead_m": EDGES_M}
    assert best["settings"] == artefacts.GRAPHS | {"labels": labels}
    curve = pd.read_csv(trained / "curve.csv")
    assert [*curve] == ["epoch", "learning_rate", "train_loss", "val_nmse"]


def test_keys_of_a_model_override_those_of_all(folder):
    own = {"epochs": 1, "learning_rate": 0.002, "span_windows": 3, "batch_spans": 5}
    write_params(folder, own)
    best = load(run_train(folder) / "best.pt")
    assert best["train"].items() >= own.items()
    assert best["epoch"] == 1


@pytest.mark.parametrize(
    "entry", [{}, {"predict": "path"}, {"spatial": "users"}], ids=["angle", "path", "users"]
)
def test_resumed_training_writes_the_same_bytes(folder, monkeypatch, capsys, entry):
    monkeypatch.setenv("STEER_WORKERS", "1")
    small_model.add_users_network(monkeypatch)
    write_params(folder, entry | {"motion": "visual"}, epochs=3)
    complete = contents(run_train(folder))
    shutil.rmtree(folder / "train")
    shutil.rmtree(folder / ".drives")

    write = checkpoint.write
    written = list[Path]()

    def interrupt(path: Path, content: dict[str, object]) -> None:
        write(path, content)
        written.append(path)
        if len(written) == 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_train(folder)
    assert not (folder / "train/net").exists()
    assert contents(run_train(folder)) == complete
    assert "net seed 0: continues after epoch 2 of 3" in capsys.readouterr().out

    # With its networks kept, as when test drives are added, nothing is trained.
    with monkeypatch.context() as patch:
        patch.setattr(Fit, "_train_epoch", None)
        assert contents(run_train(folder)) == complete


@pytest.mark.parametrize("motion", ["none", "visual"])
def test_other_motion_trains_only_networks_that_get_it(folder, capsys, motion):
    write_params(folder, {"motion": motion}, epochs=1, seeds=[0])
    run_train(folder)
    capsys.readouterr()
    for drive in SPLITS:
        artefacts.write_steered(folder / f"motion/{drive}.h5", np.linspace(0.1, 0.2, 60))
    run_train(folder)
    is_kept = "net seed 0: kept from an earlier run" in capsys.readouterr().out
    assert is_kept == (motion == "none")


def test_only_a_training_loads_the_weights_of_a_network(folder, monkeypatch):
    """A trained checkpoint needs no other file."""
    small_model.add_users_network(monkeypatch)
    started = Mock()
    monkeypatch.setattr(small_model.UsersOptions, "start", started)
    write_params(folder, {"spatial": "users"}, epochs=1, seeds=[0])
    run_train(folder)
    run_evaluate(folder)
    started.assert_called_once()


def test_training_starts_anew_where_a_drive_moves_from_validation_to_training(folder, capsys):
    write_params(folder, epochs=1)
    run_train(folder)
    moved = {"2026_01_02_drive_0001": "train"}
    artefacts.write_index(folder / "graphs/semantic", SPLITS | moved)
    run_train(folder)
    assert "continues" not in capsys.readouterr().out


def test_the_averaged_network_has_the_statistics_of_the_trained_one(folder, monkeypatch):
    small_model.add_users_network(monkeypatch)
    write_params(folder, {"spatial": "users"}, epochs=1, seeds=[0])
    average = load(run_train(folder) / "best.pt")["net"]
    (state,) = (folder / ".drives").rglob("*.pt")
    net = load(state)["net"]
    equal = {name for name in net if torch.equal(average[name], net[name])}
    statistics = {"running_mean", "running_var", "num_batches_tracked"}
    assert {f"spatial.0.{name}" for name in statistics} <= equal < {*average}


def test_seeds_in_parallel_processes_equal_those_trained_alone(folder, monkeypatch):
    write_params(folder, epochs=1, seeds=[0, 7])
    monkeypatch.setenv("STEER_WORKERS", "2")
    trained = run_train(folder)
    first = load(trained / "best.pt")
    second = load(trained / "seed-7/best.pt")
    # A seed draws the wiring, too.
    assert first["entry"]["wiring"]["seed"] == 0
    assert second["entry"]["wiring"]["seed"] == 7
    shutil.rmtree(folder / ".drives")
    write_params(folder, epochs=1, seeds=[7])
    alone = load(run_train(folder) / "best.pt")["net"]
    assert all(torch.equal(alone[name], second["net"][name]) for name in alone)
    name = "spatial.read_out.weight"
    assert not torch.equal(first["net"][name], alone[name])


def test_a_network_and_its_errors_do_not_depend_on_threads(tmp_path):
    """Sums of several threads differ from those of one, in a CNN for instance."""
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=60, kind="image", motion=True)
    write_params(tmp_path, {"spatial": "cnn", "temporal": "lstm"}, epochs=2)
    results = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        weights = contents(run_train(tmp_path))
        torch.set_num_threads(threads)
        results.append((weights, contents(run_evaluate(tmp_path))))
        shutil.rmtree(tmp_path / ".drives")
    assert results[0] == results[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "entry", "epochs", "share"),
    [
        ("graph", {"temporal": "lstm", "motion": "visual", "horizon": 5}, 20, 0.3),
        ("points", {"spatial": "pointnet2", "width": 0.125, "centres": [16, 5]}, 4, 0.6),
        ("image", {"spatial": "cnn", "alpha": 5.0, "features": 32, "temporal": "lstm"}, 10, 0.1),
    ],
)
def test_other_networks_and_inputs(tmp_path, kind, entry, epochs, share):
    """The training loss falls to a share, and the sign of angles is right."""
    artefacts.write_dataset(tmp_path, SPLITS, frames=60, points=60, kind=kind, motion=True)
    write_params(tmp_path, entry, epochs=epochs, patience=epochs, average=0.0, batch_spans=4)
    trained = run_train(tmp_path)
    assert entry.items() <= load(trained / "best.pt")["entry"].items()
    # Shares are 0.14 ± 0.01, 0.33 ± 0.06 and 0.013 ± 0.003. The last bits of a processor decide on
    # errors: for graphs, they are 0.15 to 0.66 with one seed, 0.31 ± 0.12 with two.
    loss = pd.read_csv(trained / "curve.csv")["train_loss"]
    assert loss.iloc[-1] < share * loss.iloc[0]
    assert nmse(tmp_path) < 0.85


PATH = {"predict": "path"}


@pytest.mark.parametrize(
    ("dataset", "entry", "problem"),
    [
        ({}, PATH, r"labels/2026.*needs labels.ahead_m.*repro labels"),
        ({"frames": 5, "ahead_m": EDGES_M}, PATH, "no window of 4 consecutive .* known path ahead"),
        ({"frames": 20, "ahead_m": EDGES_M}, PATH, "no frame has a known path ahead 10-20 m in"),
        ({"ahead_m": [5, 10]}, PATH, "no target of epoch 1 is known after the scene is scaled"),
        ({}, {}, f"every known steering angle of {TEST} is 0"),
        ({}, {"motion": "visual"}, "motion is not measured in any frame"),
        ({"points": 0}, {}, "0 points in all frames of .*, raise clouds.max_depth_m"),
    ],
)
def test_drives_that_teach_nothing_are_refused(tmp_path, dataset, entry, problem):
    """The test drive is straight, and motion is not measured."""
    dataset = {"frames": 60, "points": 20} | dataset
    artefacts.write_dataset(tmp_path, SPLITS, **dataset)
    with h5py.File(tmp_path / f"labels/{TEST}.h5", "a") as file:
        file["steering_rad"][:] = 0
    write_params(tmp_path, entry, epochs=1)
    with pytest.raises(InputError, match=problem) as raised:
        run_train(tmp_path)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "train/net").exists()
