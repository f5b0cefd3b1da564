import csv
import math
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.report.tables import curves


def write(path: Path, head: str, *rows: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([head, *rows, ""]))


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_each_seed_has_a_learning_curve(tmp_path: Path) -> None:
    head = "epoch,learning_rate,train_loss,val_mse_rad2,val_nmse"
    write(tmp_path / "train/net/curve.csv", head, "1,0.003,0.7,0.01,0.6", "2,0.001,0.5,0.008,0.5")
    write(tmp_path / "train/net/seed-1/curve.csv", head, "1,0.003,0.8,,")
    curves.write_learning(tmp_path / "train/net", tmp_path / "learning")
    assert sorted(path.name for path in (tmp_path / "learning").iterdir()) == ["net.csv", "net.seed-1.csv"]
    first, second = read(tmp_path / "learning/net.csv")
    assert first == {"epoch": "1", "train_loss": "0.7", "val_nmse": "0.6"}
    assert second["val_nmse"] == "0.5"
    (alone,) = read(tmp_path / "learning/net.seed-1.csv")
    assert math.isnan(float(alone["val_nmse"]))  # DVC would draw an empty field as the best of all errors


def test_the_network_of_each_fold_has_a_learning_curve(tmp_path: Path) -> None:
    for folder in ("fold-a", "fold-b", "seed-1/fold-a"):
        write(tmp_path / f"train/net/{folder}/curve.csv", "epoch,train_loss,val_nmse", "1,0.7,0.6")
    curves.write_learning(tmp_path / "train/net", tmp_path / "learning")
    made = sorted(path.name for path in (tmp_path / "learning").iterdir())
    assert made == ["net.fold-a.csv", "net.fold-b.csv", "net.seed-1.fold-a.csv"]


def test_steering_counts_on_over_drives_and_gaps_stay_gaps(tmp_path: Path) -> None:
    head = "drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid"
    rows = ["a,7,0.7,8.0,0.1,,1", "a,8,0.8,8.0,0.2,-0.1,1", "b,0,0.0,0.1,1.5,0.3,0"]
    write(tmp_path / "evaluate/net/predictions.csv", head, *rows)
    curves.write_steering(tmp_path / "evaluate/net", tmp_path / "steering")
    first, second, third = read(tmp_path / "steering/net.csv")
    assert [row["row"] for row in (first, second, third)] == ["0", "1", "2"]
    assert (second["drive"], second["frame"], second["time_s"]) == ("a", "8", "0.8")
    assert float(second["driven_deg"]) == pytest.approx(math.degrees(0.2), abs=1e-4)
    assert float(second["predicted_deg"]) == pytest.approx(math.degrees(-0.1), abs=1e-4)
    assert math.isnan(float(first["predicted_deg"]))
    assert math.isnan(float(third["driven_deg"]))  # the label says nothing there


def test_a_model_that_is_not_here_has_no_curve(tmp_path: Path) -> None:
    curves.write_learning(tmp_path / "train/net", tmp_path)
    curves.write_steering(tmp_path / "evaluate/net", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    write(tmp_path / "train/net/curve.csv", "epoch,loss", "1,2")
    with pytest.raises(InputError, match=r"net/curve\.csv.*train_loss.*dvc repro --force --single-item train@net"):
        curves.write_learning(tmp_path / "train/net", tmp_path / "learning")
    assert not (tmp_path / "learning").exists()
