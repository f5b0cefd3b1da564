"""The complete chain as a user runs it, by `dvc repro` in a scratch copy: the small sample, and real drives."""

import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from pipeline.base import store
from pipeline.camera import classes
from pipeline.sections import preset
from tests import scratch
from tests.scratch import MODEL, STAGES

pytestmark = pytest.mark.slow


def test_every_stage_runs_once_in_order(chain: Path) -> None:
    ran = [name.split("@")[0] for name in scratch.stages_run((chain / "chain.log").read_text())]
    assert ran.count("graphs") == 2
    assert tuple(name for name in dict.fromkeys(ran) if name in STAGES) == STAGES
    assert set(STAGES) == {path.name for path in (chain / "data").iterdir() if path.is_dir()} - {".resume"}


def test_the_table_has_the_numbers_of_evaluate_and_scores(chain: Path) -> None:
    table = (chain / "data/report/table.md").read_text()
    nmse = json.loads((chain / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]["nmse"]
    accuracy = json.loads((chain / "data/scores/metrics.json").read_text())["test"]["classes"]["pixel_accuracy"]
    assert any(f"{nmse:.3f}" in row for row in table.splitlines() if row.startswith(f"| {MODEL}"))
    assert f"{accuracy:.3f}" in table


def test_faults_are_one_line_and_leave_all_outputs(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    output = scratch.run(folder, "dvc", "repro")
    assert scratch.stages_run(output) == []
    params = (folder / "params.yaml").read_text()
    (folder / "params.yaml").write_text(params.replace("input: semantic", "input: semantc"))
    check_refused(scratch.run(folder, "dvc", "repro", check=False), f"models.{MODEL}: input", "semantc")
    (folder / "params.yaml").write_text(params)

    scan = sorted((folder / "data/town/2026_01_01/2026_01_01_drive_0001_sync/velodyne_points/data").iterdir())[3]
    content = scan.read_bytes()
    scan.write_bytes(content[:-7])
    output = scratch.run(folder, "dvc", "repro", "ingest", "--single-item", check=False)
    check_refused(output, "drive_0001_sync/velodyne_points", scan.name)
    scan.write_bytes(content)
    assert scratch.outputs(folder, *STAGES) == scratch.outputs(chain, *STAGES)


def test_one_word_changes_the_source_of_labels_and_no_stage_needs_oxts(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    params = yaml.safe_load((folder / "params.yaml").read_text())
    scratch.edit_params(folder, labels=params["labels"] | {"source": "visual"})
    assert scratch.changed(folder) == {"check", "labels"}
    drives = store.read_index(folder / "data/ingest", stage="ingest")
    for drive in drives:
        with h5py.File(folder / f"data/ingest/{drive}.h5", "a") as file:
            del file["oxts"]
    for stage in ("labels", "scores", f"train {MODEL}", f"evaluate {MODEL}", "report"):
        scratch.run(folder, "python", "-m", f"stages.{stage.split()[0]}", *stage.split()[1:])
    for drive in drives:
        labels = [store.DriveReader(root / f"data/labels/{drive}.h5", stage="labels") for root in (chain, folder)]
        (oxts, _), (visual, valid) = ((file["steering_rad"], file["valid"].astype(bool)) for file in labels)
        assert valid.mean() > 0.6
        assert np.mean((visual - oxts)[valid] ** 2) < 0.1 * np.mean(oxts**2)
    assert json.loads((folder / "data/scores/metrics.json").read_text())["motion"] == {
        "visual": dict.fromkeys(("train", "val", "test"))
    }


def check_refused(output: str, *parts: str) -> None:
    (line,) = (line for line in output.splitlines() if line.startswith("error: "))
    assert all(part in line for part in parts), line
    assert "Traceback" not in output


def check_same_bytes(chain: Path, folder: Path, workers: dict[str, int]) -> None:
    """Run stages again, by hand, with numbers of workers; their outputs must be those of one worker."""
    scratch.duplicate(chain, folder)
    for stage, number in workers.items():
        for entry in yaml.safe_load((folder / "params.yaml").read_text())["graphs"] if stage == "graphs" else [""]:
            command = [f"STEER_WORKERS={number}", "python", "-m", f"stages.{stage}", *([entry] if entry else [])]
            scratch.run(folder, "env", *command)
    assert scratch.outputs(folder, *workers) == scratch.outputs(chain, *workers)


def test_bytes_do_not_depend_on_workers(chain: Path, tmp_path: Path) -> None:
    """The chain ran with one."""
    check_same_bytes(chain, tmp_path / "copy", {"town": 3, "ingest": 2, "perception": 2, "clouds": 3, "graphs": 2})


@pytest.mark.soak
@pytest.mark.parametrize("number", [1, 2, 3])
def test_bytes_of_all_stages_do_not_depend_on_workers(chain: Path, tmp_path: Path, number: int) -> None:
    stages = [stage for stage in STAGES if stage not in ("encoder", "train", "evaluate", "report")]
    check_same_bytes(chain, tmp_path / "copy", dict.fromkeys(stages, number))


@pytest.mark.soak
def test_a_longer_training_predicts_steering_from_the_scene(tmp_path: Path) -> None:
    folder = scratch.copy(tmp_path / "sample")
    params = yaml.safe_load((folder / "params.yaml").read_text())
    params["town"] |= {"image_size": [96, 320], "frames": {"train": 60, "val": 50, "test": 100}}
    params["ingest"]["drives"] = {
        "train": ["2026_01_01_drive_0001..0009", "2026_01_04_drive_0001..0005"],
        "val": ["2026_01_02_drive_0001..0002"],
        "test": ["2026_01_03_drive_0001..0002"],
    }
    params["encoder"] |= {"epochs": 5, "frames": 400}
    params["graphs"] = {"semantic": params["graphs"]["semantic"] | {"points": 400}}
    scratch.edit_params(folder, **params)
    scratch.run(folder, "dvc", "repro")
    result = json.loads((folder / f"data/evaluate/{MODEL}/metrics.json").read_text())["test"]
    assert result["nmse"] < 0.8  # 1: always straight on
    assert result["baselines"]["zero"]["nmse"] == 1.0
    score = json.loads((folder / "data/scores/metrics.json").read_text())["test"]
    assert score["depth_dense"]["abs_rel"] < 0.25
    assert score["classes"]["mean_iou"] > 0.45


@pytest.mark.soak
@pytest.mark.real
def test_real_drives_run_the_same_chain(real_half: Path, real_weights: Path, tmp_path: Path) -> None:
    """Preset real, cut short: a model is trained on the sample and one of two real drives, and tested on the other.

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
    params["graphs"] = {"semantic": params["graphs"]["semantic"] | {"points": 300}, "lidar": scratch.lidar_variant(300)}
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
    result = json.loads((folder / f"data/evaluate/{model}/metrics.json").read_text())
    assert list(result["test"]["by_drive"]) == [colour]


def _cut(source: Path, root: Path, drives: dict[str, range]) -> None:
    """Link the files of some frames of drives, and all files without a frame number."""
    for drive, frames in drives.items():
        date = source / drive[:10]
        for path in (*date.glob("*.txt"), *(date / f"{drive}_sync").rglob("*.*")):
            if path.is_file() and (path.parent.name != "data" or int(path.stem) in frames):
                link = root / path.relative_to(source)
                link.parent.mkdir(parents=True, exist_ok=True)
                if not link.exists():
                    link.symlink_to(path)


def _check_folds(folder: Path, model: str, sample: list[str], real: dict[str, range]) -> None:
    """Each real drive is tested, ten frames ahead, with a network that was not trained on it, beside odometry."""
    result = json.loads((folder / f"data/evaluate/{model}/metrics.json").read_text())
    first, second = real
    # The training drives of all folds.
    assert result["drives"] == {"train": [*sample, second, first], "val": [], "test": list(real)}
    assert result["val"] is None
    window, horizon = 8, 10
    for drive, frames in real.items():
        assert (folder / f"data/train/{model}/fold-{drive}/best.pt").is_file()
        errors = result["test"]["by_drive"][drive]
        assert errors["frames"] == len(frames) - (window - 1) - horizon
        assert errors["baselines"]["zero"]["nmse"] == 1.0
        assert errors["baselines"]["odometry"]["nmse"] < 0.3  # the angle a second ago: 0.11, 0.17
        assert errors["nmse"] < 1.5  # hardly trained, but it starts from odometry
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
        # The road is 1.65 m below the camera.
        near = (np.abs(xyz[:, 0]) < 3) & (xyz[:, 2] > 4) & (xyz[:, 2] < 12)
        assert np.median(xyz[near, 1]) == pytest.approx(1.65, abs=0.15)
    else:
        assert xyz[:, 2].min() > 0
        assert not np.isin(cls, [classes.SKY, classes.VOID]).any()
