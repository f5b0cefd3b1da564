"""steer predict: its numbers equal those of stage evaluate; other sources and gaps."""

import shutil
from contextlib import chdir
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.graphs.graph_file import open_graphs
from pipeline.train.trained import load_model
from stages import clouds, encoder, graphs, ingest, labels, motion, perception, sample, train
from steer import api
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
        "accumulate": 3,
    },
    "image": {"source": "ingest"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with params.yaml and data/: three drives of a few frames, and MODELS trained on
    them.
    """
    folder = tmp_path_factory.mktemp("sample")
    params = yaml.safe_load((ROOT / "params.yaml").read_text())
    params["sample"] |= {"image_size": [96, 320], "frames": {"train": 24, "val": 8, "test": 12}}
    params["ingest"] |= {
        "image_size": [96, 320],
        "lidar": True,
        "drives": {
            "train": ["2026_01_01_drive_0001"],
            "val": ["2026_01_02_drive_0002"],
            "test": [TEST],
        },
    }
    params["encoder"]["weights"] = str(ROOT / params["encoder"]["weights"])
    params["perception"] |= {"reach": 1.1}
    params["clouds"] |= {"max_points": 2000}
    params["graphs"], params["models"] = VARIANTS, MODELS
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


def read(out: Path) -> pd.DataFrame:
    return pd.read_csv(out / "steering.csv")


@pytest.mark.parametrize("model", MODELS)
def test_predictions_equal_those_of_the_stages(folder, tmp_path, model):
    """The model knows its chain: params.yaml is not read. Each value is that of the graphs that the
    stages made.
    """
    predict(
        [drive(folder)],
        model=folder / f"data/train/{model}",
        out=tmp_path / "out",
        video=model == "path",
    )
    rows = read(tmp_path / "out")
    with open_graphs(folder / f"data/graphs/{MODELS[model]['input']}/{TEST}.h5") as graphs:
        expected = load_model(folder / f"data/train/{model}", "cpu").predict(graphs)
        assert rows["frame"].tolist() == graphs.frame.tolist()
    names = ["predicted_rad"]
    if model == "path":
        assert rows["predicted_rad"].isna().all()
        names = ["path_0_2m_1pm", "path_2_4m_1pm"]
    assert np.isfinite(expected).sum() >= 9
    np.testing.assert_allclose(rows[names], expected, atol=2e-6)


def test_a_model_is_compared_with_oxts(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    predict([drive(folder)], model=Path("data/train/scans"), out=tmp_path / "out", video=False)
    text, rows = capsys.readouterr().out, read(tmp_path / "out")
    assert "warning" not in text
    predicted_rad, driven_rad = (
        rows["predicted_rad"].to_numpy()[:-2],
        rows["driven_rad"].to_numpy()[2:],
    )
    used = np.isfinite(predicted_rad) & np.isfinite(driven_rad)
    assert f"truth from oxts, {used.sum()} frames, 2 frames ahead" in text
    nmse = ((predicted_rad - driven_rad)[used] ** 2).mean() / (driven_rad[used] ** 2).mean()
    assert f"predicted: nmse {nmse:.3f}" in text
    with pytest.raises(
        InputError, match=r"--model: no network for real streets is included\. Measure"
    ):
        predict([drive(folder)], out=tmp_path / "other")
    with pytest.raises(
        InputError, match=r"\.: has several models\. Pass one as --model: data/train/path, "
    ):
        predict([drive(folder)], model=Path(), out=tmp_path / "other")
    with pytest.raises(InputError, match=r"data/train/scan: no trained model"):
        predict([drive(folder)], model=Path("data/train/scan"), out=tmp_path / "other")
    with pytest.raises(InputError, match="has its own calibration"):
        predict(
            [drive(folder)], model=Path("data/train/scans"), out=tmp_path / "other", fov_deg=80.0
        )


def test_a_folder_of_images(folder, tmp_path, capsys):
    """Images need intrinsics and are cropped; a model of scans has no input there, and one of the
    sample no streets.
    """
    images, out = tmp_path / "2026_01_01_drive_0001", tmp_path / "out"  # a name says nothing
    images.mkdir()
    for number, path in enumerate(sorted((drive(folder) / "image_02/data").iterdir())):
        taller = cv2.copyMakeBorder(cv2.imread(str(path)), 60, 60, 0, 0, cv2.BORDER_CONSTANT)
        cv2.imwrite(str(images / f"img{number}.jpg"), taller)
    with pytest.raises(InputError, match="--fov DEGREES"):
        predict([images], model=folder / "data/train/points", out=out, fps=10.0)
    with pytest.raises(InputError, match="model scans needs LiDAR scans"):
        predict([images], model=folder / "data/train/scans", out=out, fov_deg=81.0, fps=10.0)
    assert not out.exists()
    with pytest.raises(InputError, match=r"has 5\.0 frames/s, the model was fitted to"):
        predict([images], model=folder / "data/train/points", out=out, fov_deg=81.0, fps=5.0)
    predict([images], model=folder / "data/train/points", out=out, fov_deg=81.0, fps=20.0)
    text = capsys.readouterr().out
    parts = (
        "3 predictions for 6 frames",
        "fitted to the rendered sample alone",
        "6 of 12 frames are",
    )
    assert all(part in text for part in parts)
    assert "points was fitted to depth" not in text
    video = cv2.VideoCapture(str(out / "overlay.mp4"))
    # not cropped
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (320, 216)


def test_the_model_of_the_checkout_predicts_an_angle():
    lens = {"K": "172.9,172.9,154.4,44.95", "fps": 10.0}
    table = api.predict(
        ROOT / "examples/street", model=ROOT / "models/steering/sample", **lens
    ).table
    assert np.degrees(table["predicted_rad"].iloc[-1]) == pytest.approx(17.1, abs=3)


def test_a_gap_and_a_damaged_image_start_a_new_window(folder, tmp_path, capsys):
    root, out = tmp_path / TEST[:10], tmp_path / "out"
    shutil.copytree(drive(folder).parent, root)
    images, model = root / f"{TEST}_sync/image_02/data", folder / "data/train/path"
    (images / "0000000004.png").write_bytes((images / "0000000004.png").read_bytes()[:-500])
    (images / "0000000008.png").unlink()
    predict([root / f"{TEST}_sync"], model=model, out=out, video=False)
    rows = read(out)
    assert rows["frame"].tolist() == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert rows["frame"][rows["path_0_2m_1pm"].isna()].tolist() == [0, 5, 9]
    assert "1 damaged files left out" in capsys.readouterr().out
    predict(
        [root / f"{TEST}_sync"],
        model=folder / "data/train/scans",
        out=tmp_path / "scans",
        video=False,
    )
    # frames 4 and 8 have only a scan
    assert (read(tmp_path / "scans")["frame"] == rows["frame"]).all()
    for path in images.iterdir():
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="all images of the drive are damaged"):
        predict([root / f"{TEST}_sync"], model=model, out=tmp_path / "none", video=False)
