"""steer predict: its numbers equal those of stage evaluate; other sources and gaps."""

import random
import shutil
from contextlib import chdir
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
import torch
import yaml

from pipeline.base import checkpoint
from pipeline.base.checkout import ROOT
from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import open_graphs
from pipeline.motion.motion_file import open_motion
from pipeline.perception import perceive
from pipeline.train.trained import load_model
from stages import clouds, encoder, graphs, ingest, labels, motion, perception, sample, train
from steer import api, chain, measure
from steer.commands.predict import predict

pytestmark = pytest.mark.slow

TEST = "2026_01_03_drive_0001"
MODELS = {
    "points": {
        "input": "semantic",
        "spatial": "gnn",
        "temporal": "ncp",
        "window": 4,
        "equivariant": True,
        "motion": "visual",
        "semantics": 0.0,
    },
    "scans": {
        "input": "lidar",
        "spatial": "gnn",
        "temporal": "lstm",
        "window": 3,
        "motion": "visual",
        "base": "none",
        "horizon": 2,
        "semantics": 0.0,
    },
    "path": {
        "input": "image",
        "spatial": "cnn",
        "temporal": "lstm",
        "window": 2,
        "predict": "path",
    },
}
VARIANTS = {
    "semantic": {"source": "clouds/pseudo", "points": 200, "k": 4, "keep_inter_class": 0.2},
    "lidar": {
        "source": "clouds/lidar",
        "points": 200,
        "k": 4,
        "crop_m": [-15, -10, 15, 30],
        "columns": ["intensity"],
    },
    "image": {"source": "ingest"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Write data/ with three drives of a few frames, and MODELS trained on them."""
    folder = tmp_path_factory.mktemp("sample")
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["sample"] |= {"image_size": [96, 320], "frames": {"train": 24, "val": 8, "test": 12}}
    drives = {"train": ["2026_01_01_drive_0001"], "val": ["2026_01_02_drive_0002"], "test": [TEST]}
    params["ingest"] |= {"image_size": [96, 320], "lidar": True, "drives": drives}
    params["encoder"]["weights"] = str(ROOT / params["encoder"]["weights"])
    params["clouds"] |= {"max_points": 2000, "columns": ["intensity"]}
    params["graphs"] = VARIANTS
    params["models"] = MODELS
    params["labels"] |= {"ahead_m": [0, 2, 4]}
    params["train"] |= {"epochs": 1}
    (folder / "params.yaml").write_text(yaml.safe_dump(params, sort_keys=False))
    with chdir(folder):
        for stage in (sample, ingest, labels, encoder, perception, motion, clouds):
            stage.main()
        for variant in VARIANTS:
            graphs.main(variant)
        for model in MODELS:
            train.main(model)
    (folder / "params.yaml").unlink()
    return folder


def drive(folder: Path) -> Path:
    return folder / f"data/sample/{TEST[:10]}/{TEST}_sync"


def random_state() -> list[Any]:
    """Return the state of the random numbers of Python, NumPy and torch."""
    numpy_state = np.random.get_state(legacy=False)  # noqa: NPY002
    return [random.getstate(), str(numpy_state), torch.get_rng_state().tolist()]


def read_table(out: Path) -> pd.DataFrame:
    return pd.read_csv(out / "steering.csv")


@pytest.mark.parametrize("model", MODELS)
def test_predictions_equal_those_of_the_stages(folder, tmp_path, model):
    """The model knows its chain, so params.yaml may be missing."""
    video = model == "path"
    path = folder / f"data/train/{model}"
    predict([drive(folder)], model=path, out=tmp_path / "out", video=video)
    rows = read_table(tmp_path / "out")
    with (
        open_graphs(folder / f"data/graphs/{MODELS[model]['input']}/{TEST}.h5") as graphs,
        open_motion(folder / f"data/motion/{TEST}.h5") as measured,
    ):
        expected = load_model(path, "cpu").predict(graphs, measured)
        assert rows["frame"].tolist() == graphs.frame.tolist()
    names = ["predicted_rad"]
    if model == "path":
        assert rows["predicted_rad"].isna().all()
        names = ["predicted_path_0-2m_1pm", "predicted_path_2-4m_1pm"]
    assert np.isfinite(expected).sum() >= 9
    np.testing.assert_allclose(rows[names], expected, atol=2e-6)


def test_a_prediction_for_a_training_drive_is_doubted(folder, capsys):
    source = folder / "data/sample/2026_01_01/2026_01_01_drive_0001_sync"
    outcome = api.predict(source, folder / "data/train/path")
    doubt = "path was trained on 2026_01_01_drive_0001: on other streets its error is larger"
    assert doubt in outcome.doubts


def test_a_measured_folder_is_not_measured_again(folder, tmp_path, monkeypatch):
    """The drive and its measurements are found in the folder, unless the encoder is another one."""
    encoder = folder / "data/encoder"
    reading = measure.READING.model_copy(update={"image_size": (96, 320)})
    monkeypatch.setattr(measure, "READING", reading)
    images = drive(folder) / "image_02/data"
    options = {"encoder": encoder, "fov_deg": 81.0, "fps": 10.0, "camera_height_m": 1.65}
    expected = api.measure(images, out=tmp_path / "out", **options).table

    frames = []
    passed = perceive.perceive_drive

    def count_frames(*arguments: Any, **named: Any) -> Any:
        summary = passed(*arguments, **named)
        frames.append(summary["frames"])
        return summary

    monkeypatch.setattr(chain, "perceive_drive", count_frames)
    moved = (tmp_path / "out").rename(tmp_path / "moved")
    predicted = api.predict(moved, folder / "data/train/points", encoder=encoder)
    assert frames == []
    assert any(note.startswith("depth, classes and motion are those") for note in predicted.notes)
    pd.testing.assert_series_equal(predicted.table["valid"], expected["valid"])
    assert predicted.table["predicted_rad"].notna().sum() >= 9

    record = moved / "measurement/measurement.json"
    complete = record.read_text()
    record.write_text(complete.replace('"drive": "', '"drive": "elsewhere/'))
    with pytest.raises(InputError, match="moved: its drive is missing"):
        api.predict(moved, folder / "data/train/points", encoder=encoder)
    record.write_text(complete)

    other = shutil.copytree(encoder, tmp_path / "encoder")
    content = checkpoint.load(other / "encoder.pt")
    checkpoint.write(other / "encoder.pt", content | {"note": "another file"})
    again = api.predict(moved, folder / "data/train/points", encoder=other)
    assert frames == [12]
    pd.testing.assert_frame_equal(again.table, predicted.table)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({}, r"--model: no network for real streets is included\. Measure"),
        ({"model": Path("data/train/scan")}, r"data/train/scan: no trained model"),
        ({"model": Path("data/train/scans"), "fov_deg": 80.0}, "has its own calibration"),
    ],
)
def test_wrong_options(folder, tmp_path, monkeypatch, options, problem):
    monkeypatch.chdir(folder)
    with pytest.raises(InputError, match=problem):
        predict([drive(folder)], out=tmp_path / "out", **options)


def test_a_folder_of_images(folder, tmp_path, capsys):
    """Images need intrinsics and are cropped; scans are missing, and the sample has no streets."""
    images = tmp_path / "2026_01_01_drive_0001"  # a name says nothing
    out = tmp_path / "out"
    points = folder / "data/train/points"
    images.mkdir()
    for number, path in enumerate(sorted((drive(folder) / "image_02/data").iterdir())):
        taller = cv2.copyMakeBorder(cv2.imread(str(path)), 60, 60, 0, 0, cv2.BORDER_CONSTANT)
        cv2.imwrite(str(images / f"img{number}.jpg"), taller)
    with pytest.raises(InputError, match="model scans needs LiDAR scans"):
        predict([images], model=folder / "data/train/scans", out=out, fov_deg=81.0, fps=10.0)
    assert not out.exists()
    predict([images], model=points, out=tmp_path / "slow", fov_deg=81.0, fps=5.0, video=False)
    assert "doubt: points was fitted to 9.6 frames/s, got 5.0" in capsys.readouterr().out
    predict([images], model=points, out=out, fov_deg=81.0, fps=20.0)
    text = capsys.readouterr().out
    assert "3 predictions for 6 frames" in text
    assert "fitted to the rendered sample alone" in text
    video = cv2.VideoCapture(str(out / "overlay.mp4"))
    # The video is not cropped.
    assert video.get(cv2.CAP_PROP_FRAME_WIDTH) == 320
    assert video.get(cv2.CAP_PROP_FRAME_HEIGHT) == 216


def test_the_model_of_the_checkout_predicts_an_angle_for_any_state_of_the_caller():
    lens = {"K": "172.9,172.9,154.4,44.95", "fps": 10.0}
    tables = []
    for dtype in (torch.float64, torch.float32):
        perceive._open_file.cache_clear()
        torch.set_default_dtype(dtype)
        try:
            before = random_state()
            outcome = api.predict(ROOT / "examples/street", ROOT / "models/steering/sample", **lens)
            assert random_state() == before
            assert torch.get_default_dtype() == dtype
        finally:
            torch.set_default_dtype(torch.float32)
        tables.append(outcome.table)
        torch.rand(1)
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    angle_rad = outcome.table["predicted_rad"].iloc[-1]
    assert np.degrees(angle_rad) == pytest.approx(17.1, abs=3)

    # The other model predicts a path that turns to the same side.
    outcome = api.predict(ROOT / "examples/street", ROOT / "models/steering/sample_path", **lens)
    assert outcome.table["predicted_path_0-5m_1pm"].iloc[-1] > 0.05


def test_a_gap_and_a_damaged_image_start_a_new_window(folder, tmp_path, capsys):
    date = tmp_path / TEST[:10]
    shutil.copytree(drive(folder).parent, date)
    source = date / f"{TEST}_sync"
    images = source / "image_02/data"
    damaged = images / "0000000004.png"
    damaged.write_bytes(damaged.read_bytes()[:-500])
    (images / "0000000008.png").unlink()

    model = folder / "data/train/path"
    predict([source], model=model, out=tmp_path / "out", video=False)
    rows = read_table(tmp_path / "out")
    assert rows["frame"].tolist() == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert rows["frame"][rows["predicted_path_0-2m_1pm"].isna()].tolist() == [0, 5, 9]
    assert "1 damaged files left out" in capsys.readouterr().out
    for path in images.iterdir():
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="all images of the drive are damaged"):
        predict([source], model=model, out=tmp_path / "none", video=False)
