"""Files of dvc metrics and dvc plots."""

from pathlib import Path

import pytest

from pipeline.report import dvc_files
from tests.pipeline.report import examples


def test_metrics_have_flat_names_and_no_missing_values(tmp_path: Path) -> None:
    net = examples.metrics("net") | {"val": examples.scores(0.15)}
    straight = examples.metrics("straight")
    straight["test"]["nmse"] = None
    ahead = examples.metrics("ahead", odometry={"odometry": 0.4}, horizon=10)
    found = dvc_files.metrics(examples.results(tmp_path, net, straight, ahead), None)
    mae = 4 * 0.2**0.5
    expected = {"nmse": 0.2, "nmse_low": 0.1, "nmse_high": 0.3, "mae_deg": mae, "train_nmse": 0.1, "val_nmse": 0.15}
    assert {name: found[f"net.{name}"] for name in expected} == pytest.approx(expected)
    assert "net.odometry" not in str(found)
    assert found["odometry-10.nmse"] == 0.4
    assert {"straight.nmse", "ahead.val_nmse", "odometry-0.nmse"}.isdisjoint(found)


def test_each_network_has_a_learning_curve(tmp_path: Path) -> None:
    for folder in ("", "seed-1/", "seed-1/fold-a/"):
        path = tmp_path / f"net/{folder}curve.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("epoch,learning_rate,train_loss,val_nmse\n1,0.003,0.70,0.6\n2,0.001,0.5,\n")
    dvc_files.write_learning(tmp_path / "net", tmp_path / "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["net.csv", "net.seed-1.csv", "net.seed-1.fold-a.csv"]
    # DVC would draw an empty field as 0.
    assert (tmp_path / "out/net.csv").read_text() == "epoch,train_loss,val_nmse\n1,0.70,0.6\n2,0.5,nan\n"
