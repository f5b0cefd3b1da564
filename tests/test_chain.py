"""The whole chain as a user runs it: `dvc repro` in a scratch copy, on a smaller sample and real drives."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.camera import classes
from pipeline.sections import preset
from tests import scratch

STAGE_ORDER = [
    "town", "ingest", "labels", "encoder", "perception", "motion", "scores", "clouds", "pictures", "graphs", "train",
    "evaluate", "report",
]  # fmt: skip
DETERMINISTIC = ["town", "ingest", "labels", "motion", "scores", "clouds", "pictures", "graphs", "evaluate", "report"]
MODEL = "sa-gnn-ncp"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample with fewer and smaller drives, driven through the whole chain once."""
    folder = scratch.copy(tmp_path_factory.mktemp("sample"))
    params = yaml.safe_load((folder / "params.yaml").read_text())
    params["town"] |= {"image_size": [96, 320], "frames": {"train": 60, "val": 50, "test": 100}}
    params["ingest"]["drives"] = {
        "train": ["2026_01_01_drive_0001..0009", "2026_01_04_drive_0001..0005"],
        "val": ["2026_01_02_drive_0001..0002"],
        "test": ["2026_01_03_drive_0001..0002"],
    }
    params["encoder"] |= {"epochs": 5, "frames": 400}
    params["graphs"] = {name: params["graphs"][name] | {"points": 400} for name in ("semantic", "lidar")}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    output = scratch.run(folder, "dvc", "repro")
    (folder / "first.log").write_text(output)
    return folder


def test_the_chain_ends_with_a_model_that_steers_by_what_it_sees(sample: Path) -> None:
    result = json.loads((sample / f"data/evaluate/{MODEL}/metrics.json").read_text())
    assert result["test"]["nmse"] < 0.8  # so short a training is as good as its last bits; 1 would be blind
    assert result["test"]["baselines"]["zero"]["nmse"] == 1.0
    row = next(row for row in (sample / "data/report/table.md").read_text().splitlines() if f"| {MODEL} |" in row)
    assert f"| {result['test']['nmse']:.3f} |" in row


def test_the_encoder_sees_depth_and_classes(sample: Path) -> None:
    score = json.loads((sample / "data/scores/metrics.json").read_text())["test"]
    text = json.dumps(score)
    assert score["depth_dense"]["abs_rel"] < 0.25, text
    assert score["classes"]["mean_iou"] > 0.45, text
    table = (sample / "data/report/table.md").read_text()
    assert f"| test | {score['classes']['frames']} | {score['classes']['pixel_accuracy']:.3f} |" in table


def test_every_stage_ran_once_in_order(sample: Path) -> None:
    ran = [name.split("@")[0] for name in scratch.stages_run((sample / "first.log").read_text())]
    assert [name for name in dict.fromkeys(ran) if name in STAGE_ORDER] == STAGE_ORDER
    assert set(STAGE_ORDER) == {path.name for path in (sample / "data").iterdir() if path.is_dir()} - {".resume"}


def test_again_runs_nothing(sample: Path) -> None:
    output = scratch.run(sample, "dvc", "repro")
    assert scratch.stages_run(output) == []
    assert "Data and pipelines are up to date" in output


def test_swapping_a_model_runs_its_training_and_what_follows_and_swapping_back_is_cached(sample: Path) -> None:
    original = (sample / "params.yaml").read_text()
    before = scratch.files_of(sample, ["train", "evaluate", "report"])
    (sample / "params.yaml").write_text(original.replace("temporal: ncp", "temporal: lstm"))
    swapped = [name for name in scratch.stages_run(scratch.run(sample, "dvc", "repro")) if name != "check"]
    assert swapped == [f"train@{MODEL}", f"evaluate@{MODEL}", "report"]
    assert scratch.files_of(sample, ["report"]) != {name: before[name] for name in before if "report" in name}
    (sample / "params.yaml").write_text(original)
    assert scratch.stages_run(scratch.run(sample, "dvc", "repro")) in ([], ["check"])
    assert scratch.files_of(sample, ["train", "evaluate", "report"]) == before


def test_stages_without_a_network_write_the_same_bytes_again(sample: Path) -> None:
    before = scratch.files_of(sample, DETERMINISTIC)
    again = ["dvc", "repro", "--force", "--single-item", "--no-run-cache"]
    scratch.run(sample, *again, "town", "ingest", "labels", "motion", "clouds")
    forced = ["scores", "pictures", "graphs@semantic", "graphs@lidar", f"evaluate@{MODEL}", "report"]
    scratch.run(sample, *again, *forced)
    assert scratch.files_of(sample, DETERMINISTIC) == before


def test_a_fault_in_the_params_is_one_line_before_anything_runs(sample: Path) -> None:
    original = (sample / "params.yaml").read_text()
    before = scratch.files_of(sample, STAGE_ORDER)
    try:
        (sample / "params.yaml").write_text(original.replace("input: semantic", "input: semantc"))
        output = scratch.run(sample, "dvc", "repro", check=False)
    finally:
        (sample / "params.yaml").write_text(original)
    assert "error: params.yaml: models.sa-gnn-ncp.input = 'semantc'" in output
    assert "Traceback" not in output
    assert scratch.files_of(sample, STAGE_ORDER) == before


def test_a_damaged_frame_is_one_line_and_leaves_what_was_there(sample: Path) -> None:
    scan = sorted((sample / "data/town/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data").iterdir())[3]
    before, sound = scratch.files_of(sample, STAGE_ORDER[1:]), scan.read_bytes()
    try:
        scan.write_bytes(sound[:-7])
        output = scratch.run(sample, "dvc", "repro", "ingest", "--single-item", check=False)
    finally:
        scan.write_bytes(sound)
    assert f"error: data/town/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data/{scan.name} is cut" in output
    assert "Traceback" not in output
    assert scratch.files_of(sample, STAGE_ORDER[1:]) == before
    assert scratch.stages_run(scratch.run(sample, "dvc", "repro")) == []


@pytest.mark.real
def test_real_drives_run_the_same_chain(real_kitti: Path, real_weights: Path, tmp_path: Path) -> None:
    """Drive 0052 (colour, LiDAR) trains, 0042 (grey, turning, no LiDAR) is tested; classes are ESPNetv2's."""
    folder = scratch.copy(tmp_path)
    params = preset.merged("real")
    params["ingest"]["image_size"] = [192, 640]  # a quarter of the pixels, of the time
    params["graphs"] = {name: params["graphs"][name] for name in ("semantic", "lidar")}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    (folder / "weights").symlink_to(real_weights / "espnetv2")
    (folder / "data/raw").symlink_to(real_kitti)
    output = scratch.run(folder, "dvc", "repro")
    assert "no validation drives, so no early stopping" in output
    assert "2011_10_03_drive_0042" in next(line for line in output.splitlines() if line.startswith("no scans"))
    colour, grey = "2011_09_26_drive_0052", "2011_10_03_drive_0042"

    result = json.loads((folder / f"data/evaluate/{MODEL}/metrics.json").read_text())
    assert result["drives"] == {"train": [colour], "val": [], "test": [grey]}
    assert result["val"] is None
    assert result["test"]["frames"] == 51 - 7
    assert result["test"]["baselines"]["zero"]["nmse"] == 1.0
    with store.DriveReader(folder / f"data/labels/{grey}.h5", stage="labels") as file:
        assert file["valid"].all()
        assert -0.14 < file["steering_rad"].min() < file["steering_rad"].max() < 0  # a right bend
    with store.DriveReader(folder / f"data/ingest/{grey}.h5", stage="ingest") as file:
        assert file.attrs["camera"] == 0
        image = file["image"]
        assert image.shape[0] == 51
        assert (image[..., 0] == image[..., 2]).all()
    for kind, drive, frames in (
        ("pseudo", colour, 48),
        ("pseudo", grey, 51),
        ("lidar", colour, 48),
        ("lidar", grey, 0),
    ):
        _check_cloud(folder, kind, drive, frames)
    assert {path.name for path in (folder / "data/pictures").iterdir()} == {f"{colour}.png", f"{grey}.png"}
    scores = json.loads((folder / "data/scores/metrics.json").read_text())["train"]
    assert scores["depth_lidar"]["abs_rel"] < scores["ground_plane_lidar"]["abs_rel"], json.dumps(scores)
    params["models"][MODEL]["input"] = "lidar"
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    output = scratch.run(folder, "dvc", "repro", check=False)
    assert f"with a valid label at its end in {grey}" in output


def _check_cloud(folder: Path, kind: str, drive: str, frames: int) -> None:
    with store.DriveReader(folder / f"data/clouds/{kind}/{drive}.h5", stage="clouds") as file:
        ptr: Any = file["ptr"]
        assert len(file.frame) == frames
        if not frames:
            assert len(file["xyz"]) == 0
            return
        assert np.diff(ptr).min() > 1000
        xyz, cls = file["xyz"], file["cls"]
    assert np.isfinite(xyz).all()
    if kind == "lidar":
        # The road that the scanner sees lies 1.65 m below the camera.
        near = (np.abs(xyz[:, 0]) < 3) & (xyz[:, 2] > 4) & (xyz[:, 2] < 12)
        assert np.median(xyz[near, 1]) == pytest.approx(1.65, abs=0.15)
    else:
        assert xyz[:, 2].min() > 0
        assert not np.isin(cls, [classes.SKY, classes.VOID]).any()
