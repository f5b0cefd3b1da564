"""The benchmark at a small part of its size."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from benchmarks import backbones, town_frames
from models.encoder.unified_encoder import UnifiedEncoder

K = np.array([[50.0, 0, 31], [0, 50.0, 15], [0, 0, 1]])


@pytest.mark.slow
def test_rendered_frames_are_read_as_the_stages_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEER_WORKERS", "1")
    params = tmp_path / "params.yaml"
    town_frames.write_params("kitti", params, 3, {"image_size": [48, 160], "scan_rays": [8, 60]})
    content = yaml.safe_load(params.read_text())
    content["ingest"]["image_size"] = [32, 96]
    params.write_text(yaml.safe_dump(content))
    town_frames.record(params, tmp_path)
    reading, images, intrinsics = backbones.read(tmp_path, rounds=2)
    assert images.shape == (3, 32, 96, 3)
    assert intrinsics.shape == (3, 3)
    assert images.std() > 1
    assert reading.stored_s > 0 < reading.raw_s


@pytest.mark.parametrize("name", ["small", "espnetv2-s1"])
def test_a_backbone_makes_a_row(name: str) -> None:
    row = backbones.measure(name, np.zeros((2, 32, 64, 3), np.uint8), K, rounds=1)
    assert row.parameters == sum(parameter.numel() for parameter in UnifiedEncoder(name).parameters())
    assert min(row.network_s, row.both_s, *row.single_s) > 0


@pytest.mark.parametrize("name", backbones.DEFAULT)
@pytest.mark.slow
def test_two_separate_models_say_what_the_one_says(name: str) -> None:
    torch.manual_seed(0)
    model = UnifiedEncoder(name).eval()
    image, intrinsics = torch.randint(0, 256, (1, 3, 32, 64), dtype=torch.uint8), torch.from_numpy(K)[None]
    with torch.inference_mode():
        depth, logits = model(image, intrinsics)
        depth_alone = backbones.without(model, name, "class_head")(image, intrinsics)[0]
        classes_alone = backbones.without(model, name, "depth_head")(image, intrinsics)[1]
    assert torch.equal(depth, depth_alone)
    assert torch.equal(logits, classes_alone)


def test_the_table_has_a_line_for_each_row() -> None:
    row = backbones.Row("a", 1_234, 0.05, 0.05, (0.04, 0.05))
    head, rule, *body = backbones.table([row, row], backbones.Reading(0.0125, 0.02)).splitlines()
    assert head.count("|") == rule.count("|") == body[0].count("|")
    assert body[0] == body[1] == "| a | 1,234 | 20.0 | 50.0 | 20% | 40.0 + 50.0 | 1.80 × |"
    assert "12.5 ms" in body[-1]
    assert "20.0 ms" in body[-1]
