"""Rehearse `make kitti` without KITTI: its preset as it is, on rendered drives of KITTI's size, for two epochs."""

import json
from pathlib import Path

import pytest
import torch
import yaml

from models.encoder.unified_encoder import UnifiedEncoder
from pipeline.perception import perceive
from pipeline.settings import preset
from tests import scratch

FRAMES = 40
DRIVES = {split: [f"2026_01_0{day}_drive_0001"] for day, split in enumerate(("train", "val", "test"), start=1)}


@pytest.mark.soak
def test_make_kitti_on_rendered_drives(tmp_path: Path) -> None:
    folder = scratch.copy(tmp_path / "rehearsal")
    params = preset.merged("kitti")
    sample = params["sample"] | {
        "image_size": [375, 1242],
        "scan_rays": [64, 2000],
        "frames": dict.fromkeys(DRIVES, FRAMES),
    }
    scratch.edit_params(folder, sample=sample, ingest=params["ingest"] | {"source": "sample", "drives": DRIVES})
    scratch.run(folder, "env", "STEER_WORKERS=2", "python", "-m", "stages.sample", "--out", "raw")
    (folder / "data/raw").symlink_to(folder / "raw")

    # The published weights are absent. Random depth measures no visual motion, so ours take motion from scans.
    torch.manual_seed(0)
    backbone = params["encoder"]["backbone"]
    perceive.save(folder / "weights", backbone, UnifiedEncoder(backbone).state_dict())
    scratch.edit_params(
        folder,
        **params
        | {
            "ingest": params["ingest"] | {"drives": DRIVES},
            "encoder": params["encoder"] | {"weights": "weights/encoder.pt"},
            "motion": params["motion"] | {"kinds": ["visual", "lidar"]},
            "models": {
                name: entry | ({"motion": "lidar"} if entry.get("motion") == "visual" else {})
                for name, entry in params["models"].items()
            },
            "train": params["train"] | {"epochs": 2},
        },
    )
    scratch.run(folder, "env", "STEER_WORKERS=2", "dvc", "repro")
    table = (folder / "data/report/table.md").read_text()
    for model in yaml.safe_load((folder / "params.yaml").read_text())["models"]:
        assert f"| {model}" in table or f"**{model}**" in table, table
        config = json.loads((folder / f"data/train/{model}/config.json").read_text())
        assert config["epochs"] == 2
