"""The whole chain as a user runs it: `dvc repro` in a scratch copy, on a smaller sample and real drives."""

import json
import re
import shutil
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
    lines = (sample / "data/report/table.md").read_text().splitlines()
    row = next(line for line in lines if line.startswith(f"| {MODEL} "))
    assert f" {result['test']['nmse']:.3f} |" in row


def test_the_encoder_sees_depth_and_classes(sample: Path) -> None:
    score = json.loads((sample / "data/scores/metrics.json").read_text())["test"]
    text = json.dumps(score)
    assert score["depth_dense"]["abs_rel"] < 0.25, text
    assert score["classes"]["mean_iou"] > 0.45, text
    table = (sample / "data/report/table.md").read_text()
    row = rf"\| test +\| +{score['classes']['frames']} \| +{score['classes']['pixel_accuracy']:.3f} \|"
    assert re.search(row, table)


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
def test_real_drives_run_the_same_chain(real_half: Path, real_weights: Path, tmp_path: Path) -> None:
    """Preset real, cut short: one of its models fits to the sample and to one of two real drives, and judges the other.

    0005 has colour and scans, 0042 is grey; without scans here. Depth is RT-MonoDepth-S's, classes are ESPNetv2's.
    """
    folder = scratch.copy(tmp_path)
    colour, grey, model = "2011_09_26_drive_0005", "2011_10_03_drive_0042", "motion-both-10"
    real = {colour: range(60, 110), grey: range(50)}
    _cut(real_half, folder / "data/raw", real)
    shutil.rmtree(folder / f"data/raw/{grey[:10]}/{grey}_sync/velodyne_points")
    (folder / "weights").mkdir()
    for part in ("rtmonodepth-s", "espnetv2/espnetv2_s_2.0_city_1024x512.pth"):
        (folder / "weights" / Path(part).name).symlink_to(real_weights / part)
    params = preset.merged("real")
    sample = ["2026_01_01_drive_0001", "2026_01_04_drive_0001"]
    params["town"] |= {"image_size": [96, 320], "frames": {"train": 30, "val": 1, "test": 1}}
    params["ingest"]["drives"] = {"train": sample, "val": [], "test": list(real)}
    params["encoder"] |= {"epochs": 1, "frames": 24}
    params["graphs"] = {name: params["graphs"][name] | {"points": 300} for name in ("semantic", "lidar")}
    params["models"] = {model: params["models"][model]}
    params["train"] |= {"epochs": 2, "seeds": [0]}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    output = scratch.run(folder, "dvc", "repro")
    assert "no validation drives, so no early stopping" in output
    assert grey in next(line for line in output.splitlines() if line.startswith("no scans"))
    assert f"lidar: no motion of {grey}" in output

    _check_folds(folder, model, sample, real)
    with store.DriveReader(folder / f"data/labels/{grey}.h5", stage="labels") as file:
        assert file["valid"].all()
        assert -0.14 < file["steering_rad"].min() < file["steering_rad"].max() < 0  # a right bend
    with store.DriveReader(folder / f"data/ingest/{grey}.h5", stage="ingest") as file:
        assert file.attrs["camera"] == 0
        image = file["image"]
        assert image.shape[0] == 50
        assert (image[..., 0] == image[..., 2]).all()
    for kind, drive, frames in (
        ("pseudo", colour, 50),
        ("pseudo", grey, 50),
        ("lidar", colour, 50),
        ("lidar", grey, 0),
    ):
        _check_cloud(folder, kind, drive, frames)
    assert {path.stem for path in (folder / "data/pictures").iterdir()} == {*sample, *real}
    scores = {drive: json.loads((folder / f"data/scores/{drive}/metrics.json").read_text()) for drive in real}
    assert scores[colour]["depth_lidar"]["abs_rel"] < scores[colour]["ground_plane_lidar"]["abs_rel"]
    for drive, kind in ((colour, "visual"), (colour, "lidar"), (grey, "visual")):
        assert scores[drive]["motion"][kind]["nmse"] < 0.02, f"{kind} {drive}"
        assert scores[drive]["motion"][kind]["valid"] > 0.95

    params["models"][model] |= {"input": "lidar", "motion": "lidar"}
    (folder / "params.yaml").write_text(yaml.safe_dump(params))
    output = scratch.run(folder, "dvc", "repro")
    assert grey in next(line for line in output.splitlines() if "not judged: " in line)  # it has no scans
    result = json.loads((folder / f"data/evaluate/{model}/metrics.json").read_text())
    assert list(result["test"]["by_drive"]) == [colour]


def _cut(source: Path, root: Path, drives: dict[str, range]) -> None:
    """Link what KITTI raw has of some frames of drives, and the whole of what is no frame's."""
    for drive, frames in drives.items():
        date = source / drive[:10]
        for path in (*date.glob("*.txt"), *(date / f"{drive}_sync").rglob("*.*")):
            if path.is_file() and (path.parent.name != "data" or int(path.stem) in frames):
                link = root / path.relative_to(source)
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.exists():
                    link.symlink_to(path)


def _check_folds(folder: Path, model: str, sample: list[str], real: dict[str, range]) -> None:
    """Each real drive is judged ten frames ahead by a network that has not seen it, beside what motion says."""
    result = json.loads((folder / f"data/evaluate/{model}/metrics.json").read_text())
    first, second = real
    # All that some network was fitted to: the first drive's judge, then the second's.
    assert result["drives"] == {"train": [*sample, second, first], "val": [], "test": list(real)}
    assert result["val"] is None
    window, horizon = 8, 10
    for drive, frames in real.items():
        assert (folder / f"data/train/{model}/fold-{drive}/best.pt").is_file()
        judged = result["test"]["by_drive"][drive]
        assert judged["frames"] == len(frames) - (window - 1) - horizon
        assert judged["baselines"]["zero"]["nmse"] == 1.0
        assert judged["baselines"]["odometry"]["nmse"] < 0.3  # of the angle a second ago: 0.11, 0.17
        assert judged["nmse"] < 1.5  # not trained to speak of, but odometry is where it starts
    table = (folder / "data/report/table.md").read_text()
    assert all(f" {drive} |" in table for drive in real)
    assert "| *odometry* " in table


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
