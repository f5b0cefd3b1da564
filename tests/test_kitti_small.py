"""Preset kitti-small from raw drives to the report, on three real drives with a few images each."""

import json
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


def link_drive(half: Path, raw: Path, name: str) -> None:
    """Link a drive and its calibration, with the first images only."""
    date = name[:10]
    (raw / date).mkdir(parents=True, exist_ok=True)
    for file in (half / date).glob("calib_*.txt"):
        (raw / date / file.name).unlink(missing_ok=True)
        (raw / date / file.name).symlink_to(file)
    for part in (half / date / f"{name}_sync").iterdir():
        copy = raw / date / f"{name}_sync" / part.name
        copy.mkdir(parents=True)
        for content in part.iterdir():
            if part.name.startswith("image") and content.is_dir():
                (copy / content.name).mkdir()
                for image in sorted(content.iterdir())[:IMAGES]:
                    (copy / content.name / image.name).symlink_to(image)
            else:
                (copy / content.name).symlink_to(content)


@pytest.mark.slow
@pytest.mark.real
def test_kitti_small_runs_on_real_drives(real_half, real_weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pipeline.encoder.create.WEIGHTS", real_weights)
    for name in DRIVES.values():
        link_drive(real_half, tmp_path / "data/raw", name)
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
    assert all(np.isfinite(results[f"angle-0/{model}"]["nmse"]) for model in content["models"])
