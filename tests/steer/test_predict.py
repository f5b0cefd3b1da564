"""steer predict: its numbers equal those of stage evaluate; other sources and gaps."""

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.graphs.graph_file import open_graphs
from pipeline.train.predict import load
from steer.predict import predict
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


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


@pytest.mark.parametrize("model", ["points", "scans", "images", "path"])
def test_predictions_equal_those_of_the_stages(sample: Path, tmp_path: Path, model: str) -> None:
    """The model knows its chain: params.yaml is not read. Each value is that of the graphs that the stages made."""
    (sample / "params.yaml").rename(sample / "params-moved.yaml")
    try:
        predict(drive(sample), model=sample / f"data/train/{model}", out=tmp_path / "out", video=model == "path")
    finally:
        (sample / "params-moved.yaml").rename(sample / "params.yaml")
    rows = read(tmp_path / "out/steering.csv")
    with open_graphs(sample / f"data/graphs/{trained.MODELS[model]['input']}/{trained.TEST}.h5") as graphs:
        expected = load(sample / f"data/train/{model}", "cpu").predict(graphs)
        assert [int(row["frame"]) for row in rows] == graphs.frame.tolist()
    means, sigmas = ["predicted_rad"], ["sigma_rad"]
    if model == "path":
        assert not any(row["predicted_rad"] for row in rows)
        means, sigmas = ([f"path_{edges}m_{end}" for edges in ("0_2", "2_4")] for end in ("1pm", "sigma_1pm"))
        assert (tmp_path / "out/overlay.mp4").is_file()
    pairs = [(means, expected.mean), *([] if expected.sigma is None else [(sigmas, expected.sigma)])]
    assert (expected.sigma is not None) == ("uncertainty" in trained.MODELS[model])
    for names, values in pairs:
        assert np.isfinite(values).sum() >= 9
        np.testing.assert_allclose(np.stack([column(rows, name) for name in names], 1), values, atol=2e-6)


def test_a_model_is_found_by_name_and_compared_with_oxts(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(sample)
    predict(drive(sample), model=Path("scans"), out=tmp_path / "out", video=False, as_json=True)
    comparison, rows = json.loads(capsys.readouterr().out)["comparison"], read(tmp_path / "out/steering.csv")
    predicted_rad, driven_rad = column(rows, "predicted_rad")[:-2], column(rows, "driven_rad")[2:]
    used = np.isfinite(predicted_rad) & np.isfinite(driven_rad)
    assert (comparison["truth"], comparison["frames"], comparison["horizon"]) == ("oxts", used.sum(), 2)
    nmse = ((predicted_rad - driven_rad)[used] ** 2).mean() / (driven_rad[used] ** 2).mean()
    assert comparison["predicted"]["nmse"] == pytest.approx(nmse, rel=1e-3)
    with pytest.raises(InputError, match=r"data/train/scan: no trained model"):
        predict(drive(sample), model=Path("scan"), out=tmp_path / "other")


def test_a_folder_of_images(sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Images need intrinsics and are cropped; a model of scans has no input there, and one of the sample no streets."""
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
    assert (result["frames"], result["predicted"]) == (12, 9)
    assert any("cropped to rows 60 to 156" in note for note in result["notes"])
    assert any("fitted to the rendered sample alone" in note for note in result["notes"])
    video = cv2.VideoCapture(str(out / "overlay.mp4"))
    assert (video.get(cv2.CAP_PROP_FRAME_WIDTH), video.get(cv2.CAP_PROP_FRAME_HEIGHT)) == (320, 216)  # not cropped


def test_a_gap_and_a_damaged_image_start_a_new_window(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, out = tmp_path / trained.TEST[:10], tmp_path / "out"
    shutil.copytree(drive(sample).parent, root)
    images, model = root / f"{trained.TEST}_sync/image_02/data", sample / "data/train/images"
    (images / "0000000004.png").write_bytes((images / "0000000004.png").read_bytes()[:-500])
    (images / "0000000008.png").unlink()
    other = tmp_path / "encoder"
    shutil.copytree(sample / "data/encoder", other)
    with (other / "encoder.pt").open("ab") as file:
        file.write(b"\0")  # another file, which torch reads alike
    predict(root / f"{trained.TEST}_sync", model=model, out=out, encoder=other, video=False)
    predicted = {int(row["frame"]): bool(row["predicted_rad"]) for row in read(out / "steering.csv")}
    assert sorted(predicted) == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert [frame for frame, known in predicted.items() if not known] == [0, 5, 9]
    text = capsys.readouterr().out
    assert "no frames between 3 and 5" in text
    assert "1 damaged image left out" in text
    assert "of another encoder" in text
    predict(root / f"{trained.TEST}_sync", model=sample / "data/train/scans", out=tmp_path / "scans", video=False)
    scanned, whole = read(tmp_path / "scans/steering.csv"), tmp_path / "whole"
    predict(drive(sample), model=sample / "data/train/scans", out=whole, video=False)
    expected = {row["frame"]: row["predicted_rad"] for row in read(whole / "steering.csv")}
    assert [int(row["frame"]) for row in scanned] == sorted(predicted)  # frames 4 and 8 have only a scan
    assert [row["predicted_rad"] for row in scanned[:4]] == [expected[row["frame"]] for row in scanned[:4]]
    for path in images.iterdir():
        path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="no frame could be read"):
        predict(root / f"{trained.TEST}_sync", model=model, out=tmp_path / "none", video=False)
