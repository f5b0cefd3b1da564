"""The benchmark at a thousandth of its size: every model of the paper makes a row."""

import dataclasses
from pathlib import Path

import pytest
import yaml

from benchmarks import town_frames, training_step
from pipeline.base.params import load, load_entry, names
from pipeline.sections.models import Model
from pipeline.sections.preset import merged
from pipeline.sections.train import Train
from pipeline.train import windows

FRAMES, WINDOWS = 18, 3  # 18 frames hold 3 windows of 16


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of all variants and the params file that made them: preset kitti, but small."""
    folder = tmp_path_factory.mktemp("benchmark")
    path = folder / "params.yaml"
    town_frames.write_params("kitti", path, FRAMES, {"image_size": [48, 160], "scan_rays": [24, 120]})
    content = yaml.safe_load(path.read_text())
    content["ingest"]["image_size"] = [32, 96]
    for variant in content["graphs"].values():
        if "points" in variant:
            variant["points"] = 300
    content["graphs"]["lidar-pointnet2"] |= {"centres": [16, 5], "radius_m": [8, 16], "neighbours": [6, 4]}
    content["train"] |= {"run_windows": WINDOWS, "batch_runs": 2}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STEER_WORKERS", "1")
        town_frames.make(path, folder, list(content["graphs"]))
    return folder


def test_all_models_of_the_paper_are_there_at_full_size(tmp_path: Path) -> None:
    town_frames.write_params("kitti", tmp_path / "params.yaml", FRAMES)
    assert names("models", tmp_path / "params.yaml") == list(town_frames.MODELS)
    content, kitti = yaml.safe_load((tmp_path / "params.yaml").read_text()), merged("kitti")
    assert all(content[section] == kitti[section] for section in ("graphs", "train", "clouds"))
    assert not any("width" in settings for settings in content["models"].values())


@pytest.mark.slow
@pytest.mark.parametrize("model", town_frames.MODELS)
def test_every_model_makes_a_row(folder: Path, model: str) -> None:
    params = folder / "params.yaml"
    row = training_step.measure(model, params, folder, steps=1)
    settings = load_entry(Model, "models", model, params)
    assert (row.frames, row.windows) == (
        2 * training_step.step_frames(settings.window, load(Train, params)),
        2 * WINDOWS,
    )
    figures = {key: value for key, value in dataclasses.asdict(row).items() if isinstance(value, int | float)}
    assert all(0 < value < float("inf") for value in figures.values()), figures
    assert row.peak_bytes >= row.bare_bytes
    assert row.disk_bytes == (folder / f"graphs/{settings.input}/{town_frames.DRIVE}.h5").stat().st_size / FRAMES


def test_a_frame_is_described_by_what_is_in_it(folder: Path) -> None:
    described = {}
    for variant, window in (("semantic", 8), ("lidar-pointnet2", 6), ("image", 16)):
        drives = windows.read_drives(folder / "graphs" / variant, folder / "labels", [town_frames.DRIVE], window)
        (batch,) = windows.batches(drives, [[windows.Span(0, 0, window)]], window)
        described[variant] = training_step.describe(batch)
    assert described["semantic"].startswith("300 points, ")
    assert described["lidar-pointnet2"] == "300 points, 16 × 6, 5 × 4"
    assert described["image"] == "32 × 96 pixels"


def test_the_table_has_a_line_for_each_row() -> None:
    row = training_step.Row(
        "a", "43,000 points", 31, 24, 5_000, 6.2, 0.31, 2_000_000_000, 300_000_000, 1.5e9, 6e8, 4321, 5e5, "cpu"
    )
    head, rule, *body = training_step.table([row, row]).splitlines()
    assert head.count("|") == rule.count("|") == body[0].count("|")
    assert body[0] == body[1] == "| a | 43,000 points | 31 | 6.20 | 200 | 10.0 | 2,000 | 0.50 |"
    assert body[3] == "cpu; a process with torch and nothing else: 300 MB"
    assert body[-1] == body[-2] == "| a | 5,000 | 24 | 1.50 | 600 | 4,321 |"
