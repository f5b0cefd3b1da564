"""steer predict: its numbers equal those of stage evaluate; other sources, gaps, and how a run ends."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.resume import ROOT
from pipeline.graphs.graph_file import open_graphs
from pipeline.train.predict import load
from steer.predict import predict
from tests.footage import write_video
from tests.steer import trained

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sample")
    trained.make(folder)
    return folder


def drive(sample: Path) -> Path:
    return sample / f"data/sample/{trained.TEST[:10]}/{trained.TEST}_sync"


def read(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("model", ["points", "scans", "images"])
def test_predictions_equal_those_of_evaluate(sample: Path, tmp_path: Path, model: str) -> None:
    predict(drive(sample), model=sample / f"data/train/{model}", out=tmp_path, video=False)
    evaluated, live = read(sample / f"data/evaluate/{model}/predictions.csv"), read(tmp_path / "steering.csv")
    assert [row["frame"] for row in live] == [row["frame"] for row in evaluated]
    for column in ["predicted_rad", *(["sigma_rad"] if model == "points" else [])]:
        angles = [[float(row[column] or "nan") for row in rows] for rows in (live, evaluated)]
        assert np.isfinite(angles).sum() >= 10
        np.testing.assert_allclose(*angles, atol=2e-6)  # six digits; NaN equals NaN


def test_a_model_is_found_by_name_and_compared_with_oxts(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(sample)
    predict(drive(sample), model=Path("scans"), out=tmp_path, video=False, as_json=True)
    comparison = json.loads(capsys.readouterr().out)["comparison"]
    rows = {int(row["frame"]): row for row in read(tmp_path / "steering.csv")}
    pairs = [
        (float(row["predicted_rad"]), float(rows[frame + 2]["driven_rad"]))
        for frame, row in rows.items()
        if row["predicted_rad"] and frame + 2 in rows and rows[frame + 2]["driven_rad"]
    ]
    predicted_rad, driven_rad = np.array(pairs).T
    assert (comparison["truth"], comparison["frames"], comparison["horizon"]) == ("oxts", len(pairs), 2)
    nmse = ((predicted_rad - driven_rad) ** 2).mean() / (driven_rad**2).mean()
    assert comparison["predicted"]["nmse"] == pytest.approx(nmse, rel=1e-3)
    with pytest.raises(InputError, match=r"data/train/scan: no trained model") as raised:
        predict(drive(sample), model=Path("scan"), out=tmp_path)
    assert "images, path, points, scans" in raised.value.fix


def test_a_predicted_path_has_columns_and_is_drawn(sample: Path, tmp_path: Path) -> None:
    predict(drive(sample), model=sample / "data/train/path", out=tmp_path)
    rows = read(tmp_path / "steering.csv")
    paths = [[float(row[f"path_{edges}m_1pm"] or "nan") for edges in ("0_2", "2_4")] for row in rows]
    with open_graphs(sample / f"data/graphs/image/{trained.TEST}.h5") as graphs:
        expected, sigma_1pm = load(sample / "data/train/path", "cpu").predict_with_sigma(graphs)
    np.testing.assert_allclose(paths, expected, atol=2e-6)
    sigmas = [[float(row[f"path_{edges}m_sigma_1pm"] or "nan") for edges in ("0_2", "2_4")] for row in rows]
    np.testing.assert_allclose(sigmas, sigma_1pm, atol=2e-6)
    assert np.isfinite(paths).sum() >= 20
    assert not any(row["predicted_rad"] for row in rows)
    predict(drive(sample), model=sample / "data/train/path", out=tmp_path / "again")
    unlike = sample / "data/train/images"
    predict(drive(sample), model=unlike, out=tmp_path)
    for name in ("overlay.mp4", "track.png"):
        assert (tmp_path / name).read_bytes() != (tmp_path / "again" / name).read_bytes()


def test_images_need_intrinsics_and_are_cropped(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images, out = tmp_path / "images", tmp_path / "out"
    images.mkdir()
    for number, path in enumerate(sorted((drive(sample) / "image_02/data").iterdir())):
        taller = cv2.copyMakeBorder(cv2.imread(str(path)), 60, 60, 0, 0, cv2.BORDER_CONSTANT)
        cv2.imwrite(str(images / f"img{number}.jpg"), taller)
    with pytest.raises(InputError, match=r"--calib.*--fov.*--K"):
        predict(images, model=sample / "data/train/points", out=out)
    with pytest.raises(InputError, match="model scans needs LiDAR scans"):
        predict(images, model=sample / "data/train/scans", out=out, fov=81.0)
    assert not out.exists()
    predict(images, model=sample / "data/train/points", out=out, fov=81.0, as_json=True)
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["predicted"], result["gaps"]) == (12, 9, [])
    assert all(result[key] > 0 for key in ("p50_ms", "p95_ms", "hz"))
    video = cv2.VideoCapture(result["video"])
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (320, 216)  # not cropped


def test_a_gap_and_a_damaged_image_start_a_new_window(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, out = tmp_path / trained.TEST[:10], tmp_path / "out"
    shutil.copytree(drive(sample).parent, root)
    images = root / f"{trained.TEST}_sync/image_02/data"
    (images / "0000000004.png").write_bytes((images / "0000000004.png").read_bytes()[:-500])
    (images / "0000000008.png").unlink()
    predict(root / f"{trained.TEST}_sync", model=sample / "data/train/images", out=out, video=False)
    predicted = {int(row["frame"]): bool(row["predicted_rad"]) for row in read(out / "steering.csv")}
    assert sorted(predicted) == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert [frame for frame, known in predicted.items() if not known] == [0, 5, 9]
    text = capsys.readouterr().out
    assert "no frames between 3 and 5" in text
    assert "0000000004.png" in text
    for path in images.iterdir():
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="no frame could be read"):
        predict(root / f"{trained.TEST}_sync", model=sample / "data/train/images", out=out, video=False)
    assert len(read(out / "steering.csv")) == 10  # the earlier result


def test_sigterm_ends_a_run_like_ctrl_c_and_keeps_the_earlier_result(sample: Path, tmp_path: Path) -> None:
    images = [cv2.imread(str(path)) for path in sorted((drive(sample) / "image_02/data").iterdir())]
    video = write_video(tmp_path / "street.mp4", images * 200)
    out, frames = tmp_path / "out", tmp_path / "out/.unfinished/steering.csv"
    out.mkdir()
    earlier = "drive,frame,time_s,predicted_rad\n"
    (out / "steering.csv").write_text(earlier)
    command = [sys.executable, "-m", "steer.app", "predict", str(video), "--fov", "81", "--out", str(out)]
    command += ["--model", str(sample / "data/train/images")]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "9"})
    while process.poll() is None and not (frames.exists() and frames.read_text().count("\n") > 20):
        time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 143, errors
    assert "error: interrupted" in errors
    assert (out / "steering.csv").read_text() == earlier
    assert read(frames)[-1]["latency_ms"]
    assert cv2.VideoCapture(str(frames.with_name("overlay.mp4"))).read()[0]
