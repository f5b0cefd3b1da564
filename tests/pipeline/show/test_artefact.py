"""steer show's description of the folders and files of each stage."""

import json
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.show import artefact
from tests.artefacts import write_dataset

SPLITS = {"2011_09_26_drive_0001": "train", "2011_09_26_drive_0002": "test"}


def write(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path.parent


def write_model(root: Path) -> Path:
    config = {"name": "gnn", "model": {"window": 8}, "epochs": 24, "best_epoch": 20, "splits": SPLITS}
    folder = write(root / "train/gnn/config.json", config)
    write(folder / "curve.csv", "epoch,val_nmse\n1,0.9\n24,0.25\n")
    for place in (folder, folder / "seed-1"):
        write(place / "best.pt", "")
    return folder


def test_model_by_its_folder_or_a_file_in_it(tmp_path: Path) -> None:
    folder = write_model(tmp_path)
    content = artefact.describe(folder)
    assert (content["kind"], content["model"], content["best_epoch"]) == ("model", {"window": 8}, 20)
    assert content["end_of_curve"] == {"epoch": "24", "val_nmse": "0.25"}
    assert content["drives"] == {"train": 1, "test": 1}
    assert content["checkpoints"] == ["best.pt", "seed-1/best.pt"]
    assert artefact.describe(folder / "best.pt") == content


def test_data_lists_all_artefacts_also_beside_a_damaged_one(tmp_path: Path) -> None:
    write_dataset(tmp_path, SPLITS, frames=5, points=20)
    write_model(tmp_path)
    write(tmp_path / "train/other/config.json", "{")
    write(tmp_path / "models/code.py", "")
    rows = {row["folder"]: row for row in artefact.describe(tmp_path)["parts"]}
    assert {name: row.get("kind") for name, row in rows.items()} == {
        "graphs/semantic": "folder of drives", "labels": "folder of drives",
        "train/gnn": "model", "train/other": "damaged",
    }  # fmt: skip
    assert "config.json" in rows["train/other"]["problem"]
    assert (rows["labels"]["drives"], rows["labels"]["frames"]) == (2, 10)


def test_other_files_and_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "a.h5").write_bytes(bytes(100))
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "to_itself").symlink_to(".")
    write(tmp_path / "forged/config.json", {"frames_per_drive": 3})
    for name in ("", "forged", "notes.txt", "nothing", "a.h5", "loop", "/"):
        with pytest.raises(InputError) as raised:
            artefact.describe(tmp_path / name)
        assert raised.value.fix or "damaged" in str(raised.value)
