"""Folders of all stages are told by what they hold; damaged ones in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.inspect import artefact, words
from tests import kitti_drive
from tests.artefacts import write_dataset

SPLITS = {"2011_09_26_drive_0001": "train", "2011_09_26_drive_0002": "test"}


def write(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path.parent


def model(root: Path) -> Path:
    config = {
        "name": "gnn", "model": {"input": "semantic", "window": 8}, "parameters": 9, "epochs": 24, "best_epoch": 20,
        "seeds": [0, 1], "splits": SPLITS, "target": {"std_rad": 0.1}, "train": {"epochs": 24},
    }  # fmt: skip
    folder = write(root / "train/gnn/config.json", config)
    write(folder / "curve.csv", "epoch,val_nmse\n1,0.9\n24,0.25\n")
    for place in (folder, folder / "seed-1"):
        write(place / "best.pt", "")
    return folder


def test_a_folder_of_drives(tmp_path: Path) -> None:
    write_dataset(tmp_path, SPLITS, frames=5, points=20)
    told = artefact.describe(tmp_path / "graphs/semantic")
    assert (told["kind"], told["stage"], told["frames"]) == ("folder of drives", "graphs", 10)
    assert {drive: one["split"] for drive, one in told["drives"].items()} == SPLITS
    (tmp_path / "graphs/semantic/2011_09_26_drive_0002.h5").unlink()
    told = artefact.describe(tmp_path / "graphs/semantic")
    assert (told["lacking"], told["frames"]) == (["2011_09_26_drive_0002"], 5)
    assert any("not here: 2011_09_26_drive_0002" in line for line in words.artefact(told))


def test_a_model_by_its_folder_or_any_file_in_it(tmp_path: Path) -> None:
    folder = model(tmp_path)
    told = artefact.describe(folder)
    assert (told["kind"], told["line"]["window"], told["best_epoch"]) == ("model", 8, 20)
    assert told["curve_end"] == {"epoch": "24", "val_nmse": "0.25"}
    assert told["drives"] == {"train": 1, "test": 1}
    assert told["made_of"] == list(SPLITS)
    assert told["networks"] == [".", "seed-1"]
    assert artefact.describe(folder / "best.pt") == told
    text = "\n".join(words.artefact(told))
    assert "best epoch 20 of 24" in text
    assert "networks: ., seed-1" in text


def test_an_encoder_an_evaluation_and_scores(tmp_path: Path) -> None:
    encoder = write(tmp_path / "encoder/config.json", {"backbone": "small", "frames_per_drive": {"a": 3, "b": 4}})
    assert artefact.describe(encoder)["made_of"] == ["a", "b"]
    metrics = {
        "model": "gnn", "line": {}, "drives": {"train": ["a"], "test": ["b"]}, "val": None, "parameters": 9,
        "test": {"nmse": 0.5, "baselines": {"zero": {"nmse": 1.0}, "odometry": None}, "by_drive": {}},
    }  # fmt: skip
    folder = write(tmp_path / "evaluate/gnn/metrics.json", metrics)
    write(folder / "predictions.csv", "")
    told = artefact.describe(folder)
    assert told["errors"]["test"] == {"nmse": 0.5, "baselines_nmse": {"zero": 1.0, "odometry": None}}
    assert told["errors"]["val"] == {}
    assert told["made_of"] == ["a", "b"]
    scores = write(tmp_path / "scores/metrics.json", {"test": {"depth": {"abs_rel": 0.1, "ok": True}, "huge": 10**400}})
    assert artefact.describe(scores)["figures"] == {"test.depth.abs_rel": 0.1}
    for each in (encoder, folder, scores):
        assert list(words.artefact(artefact.describe(each)))


def test_a_folder_of_artefacts_tells_each_even_beside_a_damaged_one(tmp_path: Path) -> None:
    write_dataset(tmp_path, SPLITS, frames=5, points=20)
    model(tmp_path)
    write(tmp_path / "train/other/config.json", "{")
    write(tmp_path / "train/other/best.pt", "")
    told = artefact.describe(tmp_path)
    assert {name: one.get("kind") for name, one in told["parts"].items()} == {
        "graphs/semantic": "folder of drives", "labels": "folder of drives", "train/gnn": "model", "train/other": None,
    }  # fmt: skip
    assert "not a JSON" in told["parts"]["train/other"]["error"] or "damaged" in told["parts"]["train/other"]["error"]
    assert any("train/gnn: model" in line for line in words.artefact(told))


def test_raw_drives_and_their_folder(tmp_path: Path) -> None:
    folder = kitti_drive.write_drive(tmp_path, frames=[0, 1, 4])
    told = artefact.describe(folder)
    assert told["modalities"]["image_02"]["gaps"] == [[2, 3]]
    assert told["modalities"]["velodyne_points"]["files"] == 3
    assert told["modalities"]["oxts"]["stamps"] == kitti_drive.LINES
    assert told["modalities"]["image_02"]["stamps"] is None
    assert told["calibration"] == ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"]
    for root in (tmp_path, folder.parent):
        told_root = artefact.describe(root)
        assert told_root["drives"] == {kitti_drive.DRIVE: {"oxts": 3, "image_02": 3, "velodyne_points": 3}}
        assert any(kitti_drive.DRIVE in line for line in words.artefact(told_root))
    assert any("2-3" in line for line in words.artefact(told))


@pytest.mark.parametrize(
    "content",
    ["", "[]", "null", "3", "{}", "{", "[" * 100_000, '{"drives": []}', '{"drives": {"../up": "train"}}', "9" * 9000],
)
def test_a_damaged_index_is_one_line(tmp_path: Path, content: str) -> None:
    write(tmp_path / "labels/index.json", content)
    with pytest.raises(InputError, match=r"index\.json") as error:
        artefact.describe(tmp_path / "labels")
    assert len(str(error.value)) < 500


@pytest.mark.parametrize("content", ['{"model": [], "splits": 3, "train": null}', "{}", '{"target": [1, {"a": {}}]}'])
def test_a_config_of_another_shape_is_told_as_far_as_it_goes(tmp_path: Path, content: str) -> None:
    folder = model(tmp_path)
    write(folder / "config.json", content)
    assert list(words.artefact(artefact.describe(folder)))


def test_pictures(tmp_path: Path) -> None:
    write(tmp_path / "pictures/2011_09_26_drive_0001.png", "")
    told = artefact.describe(tmp_path / "pictures")
    assert (told["kind"], told["made_of"]) == ("pictures", ["2011_09_26_drive_0001"])
    assert any("of 1 drive: 2011_09_26_drive_0001" in line for line in words.artefact(told))


def test_what_no_stage_writes_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds nothing that a stage writes"):
        artefact.describe(tmp_path)
    with pytest.raises(InputError, match="is missing"):
        artefact.describe(tmp_path / "nothing")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="no artefact of a stage"):
        artefact.describe(tmp_path / "notes.txt")
    (tmp_path / "a.h5").write_bytes(np.zeros(100).tobytes())
    with pytest.raises(InputError, match=r"a\.h5 is damaged"):
        artefact.describe(tmp_path / "a.h5")
