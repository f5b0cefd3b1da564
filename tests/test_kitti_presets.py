"""Presets kitti and kitti-small from raw drives to the report.

The drives have a few frames each: real ones, and rendered ones under the names of KITTI's.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from pipeline.base.checkout import ROOT
from pipeline.base.params import read_yaml
from pipeline.ingest.settings import Drives
from pipeline.sample.render import render_drive
from pipeline.sample.rig import make_rig, write_calibration
from pipeline.sample.settings import Sample
from stages import (
    check,
    clouds,
    encoder,
    evaluate,
    graphs,
    ingest,
    labels,
    motion,
    perception,
    preset,
    report,
    scores,
    train,
)

DRIVES = {
    "train": "2011_09_26_drive_0005",
    "val": "2011_09_26_drive_0039",
    "test": "2011_10_03_drive_0042",
}
IMAGES = 16  # of each real drive
# Frames of each rendered drive. The CNN sees 16, and motion-10 predicts 10 frames after 8.
FRAMES = 24
# Largest number of points of a frame.
POINTS = 128
# Options of PointNet++ for so few points.
FEW_CENTRES = {"centres": [32, 8], "neighbours": [8, 8], "width": 0.25}


def later_images(_: str, names: list[str]) -> list[str]:
    """Return the images of a folder that are not copied."""
    return sorted(name for name in names if name.endswith(".png"))[IMAGES:]


@pytest.mark.slow
@pytest.mark.real
def test_kitti_small_runs_on_real_drives(real_half, real_weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pipeline.encoder.create.WEIGHTS", real_weights)
    for name in DRIVES.values():
        date = Path(name[:10])
        drive = date / f"{name}_sync"
        shutil.copytree(real_half / drive, Path("data/raw") / drive, ignore=later_images)
        for file in (real_half / date).glob("calib_*.txt"):
            shutil.copy(file, Path("data/raw") / date)
    content = preset.merge_preset("kitti-small")
    content["ingest"]["drives"] = {split: [name] for split, name in DRIVES.items()}
    content["train"]["epochs"] = 2
    run_stages(content)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    """Return data/raw with rendered drives under the names of all drives of preset kitti."""
    raw = tmp_path_factory.mktemp("kitti") / "raw"
    chosen = preset.merge_preset("kitti")
    size = (96, 320)
    settings = Sample(**chosen["sample"] | {"image_size": size, "scan_rays": (16, 60)})
    for drive in Drives(**chosen["ingest"]["drives"]).splits():
        date = raw / drive[:10]
        folder = date / f"{drive}_sync"
        folder.mkdir(parents=True)
        render_drive(folder, drive, settings, frames=FRAMES, lidar=True, truth=False)
        write_calibration(make_rig(size, date.name), date)
    return raw


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kitti", "kitti-small"])
def test_the_presets_run_on_rendered_drives_of_kittis_names(name, rendered, tmp_path, monkeypatch):
    """With the drives, models and graphs of the preset, and the encoder of rendered streets."""
    monkeypatch.chdir(tmp_path)
    Path("data").mkdir()
    Path("data/raw").symlink_to(rendered)
    content = preset.merge_preset(name)
    content["encoder"] = read_yaml(ROOT / "params.yaml")["encoder"]
    content["encoder"]["weights"] = str(ROOT / content["encoder"]["weights"])
    content["ingest"]["image_size"] = [96, 320]
    content["clouds"]["max_points"] = POINTS
    for variant in content["graphs"].values():
        if "points" in variant:
            variant["points"] = POINTS
    for entry in content["models"].values():
        if entry["spatial"] == "pointnet2":
            entry |= FEW_CENTRES
    content["train"]["epochs"] = 1
    content["evaluate"]["bootstrap_samples"] = 100
    run_stages(content)


def run_stages(content: dict[str, Any]) -> None:
    """Run all stages in the working folder. The report has an error of each model."""
    Path("params.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(content))))
    for stage in (check, ingest, encoder, perception, motion, labels, scores, clouds):
        stage.main()
    for variant in content["graphs"]:
        graphs.main(variant)
    for model in content["models"]:
        train.main(model)
        evaluate.main(model)
    report.main()
    assert Path("data/report/index.html").stat().st_size
    results = json.loads(Path("data/report/results.json").read_text())
    for model, entry in content["models"].items():
        row = results[f"angle-{entry.get('horizon', 0)}/{model}"]
        assert np.isfinite(row["nmse"])
        assert row["frames"]
