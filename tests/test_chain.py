"""The complete chain as a user runs it, by `dvc repro` in a scratch copy: the small sample, and real drives."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.base import store
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
    assert f"lidar: no motion of {grey}" in output
    result = json.loads((folder / f"data/evaluate/{model}/metrics.json").read_text())
    for drive in real:  # ten frames ahead, with a network that was not trained on the drive
        assert (folder / f"data/train/{model}/fold-{drive}/best.pt").is_file()
        errors = result["test"]["by_drive"][drive]
        assert errors["frames"] == 50 - 7 - 10
        assert errors["baselines"]["odometry"]["nmse"] < 0.3  # the angle a second ago
        assert errors["nmse"] < 1.5  # hardly trained, but it starts from odometry
    with store.DriveReader(folder / f"data/labels/{grey}.h5", stage="labels") as file:
        assert -0.14 < file["steering_rad"].min() < file["steering_rad"].max() < 0  # a right bend
    with store.DriveReader(folder / f"data/clouds/lidar/{colour}.h5", stage="clouds") as file:
        x, y, z = file["xyz"].T
        road = (np.abs(x) < 3) & (z > 4) & (z < 12)
        assert np.median(y[road]) == pytest.approx(1.65, abs=0.15)  # below the camera
    scores = {drive: json.loads((folder / f"data/scores/{drive}/metrics.json").read_text()) for drive in real}
    assert scores[colour]["depth_lidar"]["abs_rel"] < scores[colour]["ground_plane_lidar"]["abs_rel"]
    assert scores[grey]["motion"]["visual"]["nmse"] < 0.02


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
