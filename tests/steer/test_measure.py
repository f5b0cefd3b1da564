"""steer measure: known motion of a rendered street, and input that shows no motion of a car."""

import json
import re
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.ingest.datasets import kitti
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.write import write_drive
from steer import api
from steer.commands.measure import measure
from steer.measure import READING
from tests import street
from tests.flat_ground import write_encoder
from tests.kitti_drive import write, write_folder

# Yaw rate in rad/s and speed in m/s of the rendered drive.
YAW_RATE = 0.2
SPEED = 8.0
LENS: dict[str, Any] = {"K": "180,180,159.5,44", "fps": 10.0, "camera_height_m": CAMERA_HEIGHT_M}


@pytest.fixture
def encoder(tmp_path, monkeypatch) -> Path:
    return write_encoder(tmp_path / "encoder", monkeypatch)


def drive(count: int, start: int = 0) -> list[np.ndarray]:
    """Return images of a drive that turns left."""
    return [street.view(pose)[0] for pose in street.arc(start + count, YAW_RATE, SPEED)[start:]]


def write_log(path: Path, times_s: list[float], speed: float) -> Path:
    rows = "".join(f"{time_s},{speed},{YAW_RATE}\n" for time_s in times_s)
    path.write_text(f"time_s,speed_mps,yaw_rate_radps\n{rows}")
    return path


def read_motion(out: Path) -> dict[str, np.ndarray]:
    return {name: column.to_numpy() for name, column in pd.read_csv(out / "motion.csv").items()}


def test_motion_is_measured_from_python(tmp_path, encoder):
    images = write_folder(tmp_path / "images", drive(30))
    outcome = api.measure(str(images), encoder=encoder, **LENS)
    assert outcome.table["valid"].sum() == 29
    assert outcome.files == []
    assert outcome.doubts == []
    with pytest.raises(TypeError, match=r"'camera_height': did you mean camera_height_m"):
        api.measure(images, encoder=encoder, camera_height=1.4)
    for option, value, problem in (
        ("fov_deg", "65", r"^fov: .*valid number \(got '65'\)"),
        ("wheelbase_m", 2700, r"^wheelbase: .* less than or equal to 20 \(got 2700\)"),
        ("wheelbase_m", -2.7, r"^wheelbase: .* greater than or equal to 0.5 \(got -2.7\)"),
        ("wheelbase_m", 0, r"^wheelbase: .* greater than or equal to 0.5 \(got 0\)"),
        ("wheelbase_m", np.nan, r"^wheelbase: .* finite number \(got nan\)"),
    ):
        with pytest.raises(InputError, match=problem):
            api.measure(images, encoder=encoder, **{option: value})


def test_known_motion_is_measured_and_drawn(tmp_path, encoder, capsys):
    """The log has km/h, begins 10 s late and ends at 2 s of the images."""
    out = tmp_path / "out"
    images = write_folder(tmp_path / "images", drive(30))
    log = write_log(tmp_path / "can.csv", [10.0, 10.5, 11.0, 11.5, 12.0], 3.6 * SPEED)
    options = LENS | {"offset_s": -10, "distortion": "0,0,0,0"}
    measure([images], out=out, encoder=encoder, motion=log, **options)
    text = capsys.readouterr().out
    assert "speed_mps is known at 21 of 30 images" in text
    assert re.search(r"doubt: speed of the log: 3\.\d\d times the measured one; the sign", text)

    rows = read_motion(out)
    assert rows["valid"].tolist() == [0] + 29 * [1]
    assert rows["yaw_rate_radps"][1:] == pytest.approx(YAW_RATE, abs=0.02)
    assert rows["speed_mps"][1:] == pytest.approx(SPEED, rel=0.1)
    assert rows["measured_rad"][1:] == pytest.approx(np.arctan(2.7 * YAW_RATE / SPEED), abs=0.01)
    assert rows["heading_rad"][-1] == pytest.approx(2.9 * YAW_RATE, rel=0.1)
    to_the_left_m = SPEED / YAW_RATE * (1 - np.cos(2.9 * YAW_RATE))
    assert rows["y_m"][-1] == pytest.approx(to_the_left_m, rel=0.2)
    quality = json.loads((out / "quality.json").read_text())
    assert quality["road_height_m"] == pytest.approx(CAMERA_HEIGHT_M, rel=0.1)
    assert quality["recorded"]["speed"]["ratio"] == pytest.approx(3.6, rel=0.1)
    assert quality["comparison"]["frames"] == 20
    assert quality["speed_sigma"] < 0.1
    with av.open(str(out / "overlay.mp4")) as file:
        assert sum(1 for _ in file.decode(video=0)) == 30


def test_gaps_between_files_are_doubted_and_remembered(tmp_path, encoder):
    names = ("20260101_100000", "20260101_100100")
    images = [write_folder(tmp_path / name, drive(4)) for name in names]
    outcome = api.measure(images, encoder=encoder, out=tmp_path / "out", **LENS)
    assert outcome.notes[0].startswith(f"{names[0]}: 4 images, 0.4 s, taken to begin at 0.0 s")
    gap = "by the file's name, 60 s are missing between 20260101_100000 and 20260101_100100"
    assert sum(doubt.startswith(gap) for doubt in outcome.doubts) == 1

    # A drive that was made of several files says so, since a log then has no single offset.
    for folder, count in ((tmp_path / "out/drive", 2), (tmp_path / "one/drive", 1)):
        if count == 1:
            api.measure(images[:1], encoder=encoder, out=folder.parent, **LENS)
        source = kitti.open_folder(folder / f"{names[0]}_drive_0001_sync")
        write_drive(tmp_path / f"{count}.h5", kitti.read_drive(source, READING), "a", "k", READING)
        with open_ingest(tmp_path / f"{count}.h5") as file:
            assert file.params.get("recordings", 1) == count


def noisy(image: np.ndarray) -> np.ndarray:
    """Return 12 images of a still camera."""
    noise = np.random.default_rng(0).normal(0, 2, (12, *street.WIDE.size, 3))
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def snow() -> np.ndarray:
    shape = (12, *street.WIDE.size, 3)
    return np.random.default_rng(0).integers(0, 255, shape, np.uint8)


@pytest.mark.parametrize(
    "images",
    [lambda: noisy(drive(1)[0]), snow],
    ids=["standing", "snow"],
)
def test_input_without_motion_gets_no_numbers(tmp_path, encoder, images, capsys):
    folder = write_folder(tmp_path / "images", images())
    measure([folder], out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    rows = read_motion(tmp_path / "out")
    assert not rows["valid"].any()
    for name in ("speed_mps", "yaw_rate_radps", "measured_rad", "x_m"):
        assert np.isnan(rows[name]).all()
    quality = json.loads((tmp_path / "out/quality.json").read_text())
    assert quality["step_m"] is None
    assert quality["scatter"] is None
    assert "horizon: not found" in capsys.readouterr().out


def test_a_cut_is_not_a_motion(tmp_path, encoder):
    before = [image[:, ::-1] for image in drive(10)]
    images = write_folder(tmp_path / "images", [*before, *drive(10, start=25)])
    measure([images], out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    rows = read_motion(tmp_path / "out")
    yaw_rate = rows["yaw_rate_radps"]
    assert rows["valid"].tolist() == [0, *9 * [1], 0, *9 * [1]]
    assert yaw_rate[1:6] == pytest.approx(-YAW_RATE, abs=0.02)  # mirrored
    assert yaw_rate[15:] == pytest.approx(YAW_RATE, abs=0.02)


def test_the_written_drive_is_a_source_with_the_same_numbers(tmp_path, encoder):
    images = write_folder(tmp_path / "images", drive(12))
    log = write_log(tmp_path / "can.csv", [number / 10 for number in range(12)], SPEED)
    options = {"encoder": encoder, "video": False}
    measure([images], out=tmp_path / "first", motion=log, **LENS, **options)
    source = tmp_path / "first/drive/images_drive_0001_sync"
    measure([source], out=tmp_path / "second", **options)
    for name in ("motion.csv", "track.png"):
        assert (tmp_path / "second" / name).read_bytes() == (tmp_path / "first" / name).read_bytes()
    assert not (tmp_path / "second/drive").exists()
    problem = r"has its own calibration, times and logs. Remove --K, --fps, --camera-height"
    with pytest.raises(InputError, match=problem):
        measure([source], out=tmp_path / "third", **LENS, **options)


def test_unsuitable_inputs(tmp_path, encoder, monkeypatch):
    images = write_folder(tmp_path / "images", drive(4))
    write(tmp_path / "kept/poses.txt", "mine")
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        measure([images], encoder=encoder, video=False, **LENS)
    for name in ("images", "images-2"):
        assert len(read_motion(tmp_path / f"out/{name}")["frame"]) == 4
    with pytest.raises(InputError, match=r"^wheelbase: .* \(got 2700.0\)"):
        measure([images], wheelbase=2700.0)
    with pytest.raises(InputError, match="no encoder"):
        measure([images], encoder=tmp_path, **LENS)
    with pytest.raises(InputError, match=r"exists already and holds poses\.txt"):
        measure([images], encoder=encoder, out=tmp_path / "kept", **LENS)
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["poses.txt"]
    with pytest.raises(InputError, match="fewer than 2 images"):
        measure([write_folder(tmp_path / "single", drive(1))], encoder=encoder, **LENS)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"images", "images-2"}
