"""Files of dvc metrics and dvc plots."""

from pathlib import Path

from pipeline.report import dvc_files
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics


def test_metrics_have_flat_names_and_no_missing_values(tmp_path: Path) -> None:
    net = metrics("net") | {"val": {"steering_rad": examples.scores(0.15)}}
    groups = examples.groups(
        tmp_path, net, metrics("straight", None), metrics("path", odometry={"odometry": 0.4}, predict="path")
    )
    found = dvc_files.metrics(groups)
    of_net = {"nmse": 0.2, "nmse_low": 0.1, "nmse_high": 0.2 * 1.5, "train_nmse": 0.1, "val_nmse": 0.15}
    assert {name: value for name, value in found.items() if name.startswith("net")} == {
        f"net.{name}": value for name, value in of_net.items()
    }
    assert (found["path.nmse_5-10m"], found["path.nmse_5-10m_low"], found["odometry-path-0.nmse_0-5m"]) == (
        0.2,
        0.1,
        0.4,
    )
    assert not any(name.startswith("straight") or "odometry-angle" in name for name in found)


def test_each_network_has_a_learning_curve(tmp_path: Path) -> None:
    for folder in ("", "seed-1/", "seed-1/fold-a/"):
        path = tmp_path / f"net/{folder}curve.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("epoch,learning_rate,train_loss,val_nmse\n1,0.003,0.70,0.6\n2,0.001,0.5,\n")
    (tmp_path / "out").mkdir()
    dvc_files.write_learning(tmp_path / "net", tmp_path / "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["net.csv", "net.seed-1.csv", "net.seed-1.fold-a.csv"]
    assert (tmp_path / "out/net.csv").read_text() == "epoch,train_loss,val_nmse\n1,0.70,0.6\n2,0.5,nan\n"
