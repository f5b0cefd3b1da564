"""steer predict says of a drive what stage evaluate says of it, and of other sources what it can."""

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from steer.predict import predict
from tests.steer import trained

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sample")
    trained.make(folder)
    return folder


def drive(sample: Path) -> Path:
    return sample / f"data/town/{trained.TEST[:10]}/{trained.TEST}_sync"


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("model", trained.MODELS)
def test_the_numbers_are_those_of_evaluate(sample: Path, tmp_path: Path, model: str) -> None:
    predict(drive(sample), model=sample / f"data/train/{model}", out=tmp_path, video=False)
    judged = rows_of(sample / f"data/evaluate/{model}/predictions.csv")
    said = rows_of(tmp_path / "steering.csv")
    assert [row["frame"] for row in said] == [row["frame"] for row in judged]
    assert [bool(row["predicted_rad"]) for row in said] == [bool(row["predicted_rad"]) for row in judged]
    angles = [[float(row["predicted_rad"] or "nan") for row in rows] for rows in (said, judged)]
    assert np.isfinite(angles).sum() >= 10
    np.testing.assert_allclose(*angles, atol=2e-6)  # six digits


def test_a_folder_of_images_needs_a_lens_and_is_cut_to_the_shape_that_was_learned(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for number, path in enumerate(sorted((drive(sample) / "image_02/data").iterdir())):
        image = cv2.imread(str(path))
        # Three of four images are taller than what was learned, as a phone's are: the street is in the middle.
        cv2.imwrite(str(images / f"img{number}.jpg"), cv2.copyMakeBorder(image, 60, 60, 0, 0, cv2.BORDER_CONSTANT))
    with pytest.raises(InputError, match=r"said nowhere: say one of --calib FILE.*--fov.*--K"):
        predict(images, model=sample / "data/train/points", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    predict(images, model=sample / "data/train/points", out=tmp_path / "out", fov=81.0, as_json=True)
    said = json.loads(capsys.readouterr().out)
    assert (said["frames"], said["predicted"], said["gaps"]) == (12, 9, [])
    assert all(said[key] > 0 for key in ("p50_ms", "p95_ms", "hz"))
    video = cv2.VideoCapture(said["video"])
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 12
    assert abs(video.get(cv2.CAP_PROP_FRAME_WIDTH) / video.get(cv2.CAP_PROP_FRAME_HEIGHT) - 320 / 96) < 0.1
    with pytest.raises(InputError, match="model scans takes LiDAR scans"):
        predict(images, model=sample / "data/train/scans", out=tmp_path / "out", fov=81.0)


def test_a_gap_and_a_damaged_image_start_the_window_anew(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / trained.TEST[:10]
    shutil.copytree(drive(sample).parent, root)
    images = root / f"{trained.TEST}_sync/image_02/data"
    (images / "0000000004.png").write_bytes((images / "0000000004.png").read_bytes()[:-500])
    (images / "0000000008.png").unlink()
    predict(root / f"{trained.TEST}_sync", model=sample / "data/train/images", out=tmp_path / "out", video=False)
    predicted = {int(row["frame"]): bool(row["predicted_rad"]) for row in rows_of(tmp_path / "out/steering.csv")}
    assert [frame for frame, known in predicted.items() if not known] == [0, 5, 9]
    assert sorted(predicted) == [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]
    said = capsys.readouterr().out
    assert "frame 5 comes after 3: the window starts again" in said
    assert "left out: " in said
    assert "0000000004.png" in said


def test_what_is_written_is_whole_when_it_ends_early(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pipeline.live.overlay import Overlay

    added: list[object] = []

    def interrupted(self: Overlay, moment: object) -> None:
        added.append(moment)
        if len(added) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(Overlay, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        predict(drive(sample), model=sample / "data/train/images", out=tmp_path)
    rows = rows_of(tmp_path / "steering.csv")
    assert [row["frame"] for row in rows] == list("01234")
    assert rows[-1]["latency_ms"]


def test_settings_that_the_model_was_not_trained_with_are_refused(sample: Path, tmp_path: Path) -> None:
    params = tmp_path / "params.yaml"
    params.write_text((sample / "params.yaml").read_text().replace("reach: 1.1", "reach: 2.0"))
    with pytest.raises(InputError, match=r"perception: reach = 2.0, but .* was made with 1.1.*--params"):
        predict(drive(sample), model=sample / "data/train/points", out=tmp_path / "out", params=params)
    moved = tmp_path / "model"
    shutil.copytree(sample / "data/train/points", moved)
    with pytest.raises(InputError, match="give --encoder"):
        predict(drive(sample), model=moved, out=tmp_path / "out")
    predict(
        drive(sample), model=moved, out=tmp_path / "out", video=False, quiet=True,
        encoder=sample / "data/encoder", params=sample / "params.yaml",
    )  # fmt: skip
    assert len(rows_of(tmp_path / "out/steering.csv")) == 12
