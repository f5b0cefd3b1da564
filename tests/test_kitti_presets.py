"""Preset kitti-small from raw drives to the report, on three real drives with a few images each."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

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
IMAGES = 16  # of each drive


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
    Path("params.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(content))))
    for stage in (check, ingest, encoder, perception, motion, labels, scores, clouds):
        stage.main()
    graphs.main("semantic")
    for model in content["models"]:
        train.main(model)
        evaluate.main(model)
    report.main()
    results = json.loads(Path("data/report/results.json").read_text())
    for model in content["models"]:
        assert np.isfinite(results[f"angle-0/{model}"]["nmse"])
