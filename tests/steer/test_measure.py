"""steer measure: known motion of a rendered street, and input that shows no motion of a car."""

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import av
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.base.store import DriveReader
from pipeline.camera.geometry import CAMERA_HEIGHT_M
from pipeline.check import preset
from pipeline.ingest import recording as opening
from pipeline.ingest.datasets import recording
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.settings import Ingest, RecordingOptions
from pipeline.motion import horizon
from pipeline.motion.motion_file import measure_drive
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception
from steer import api, chain
from steer.commands.import_ import import_recording
from steer.commands.measure import measure
from steer.measure import READING
from tests import street
from tests.flat_ground import write_encoder
from tests.kitti_drive import write, write_folder

YAW_RATE, SPEED = 0.2, 8.0
LENS: dict[str, Any] = {"K": "180,180,159.5,44", "fps": 10.0, "camera_height_m": CAMERA_HEIGHT_M}


@pytest.fixture
def encoder(tmp_path, monkeypatch) -> Path:
    return write_encoder(tmp_path / "encoder", monkeypatch)


def drive(count: int, start: int = 0) -> list[np.ndarray]:
    return [street.view(pose)[0] for pose in street.arc(start + count, YAW_RATE, SPEED)[start:]]


def read(out: Path) -> dict[str, np.ndarray]:
    return {name: column.to_numpy() for name, column in pd.read_csv(out / "motion.csv").items()}


def test_known_motion_is_measured_and_drawn(tmp_path, encoder, capsys):
    out, images, log = (
        tmp_path / "out",
        write_folder(tmp_path / "images", drive(30)),
        tmp_path / "can.csv",
    )
    rows = [f"{10 + number / 2},{3.6 * SPEED},{YAW_RATE}\n" for number in range(5)]
    log.write_text("time_s,speed_mps,yaw_rate_radps\n" + "".join(rows))
    with pytest.raises(
        InputError, match=r"log is from 10\.0 to 12\.0 s, the images from 0\.0 to 2\.9 s"
    ):
        measure([images], out=out, encoder=encoder, motion=log, **LENS)
    measure(
        [images], out=out, encoder=encoder, motion=log, offset_s=-10, distortion="0,0,0,0", **LENS
    )
    assert "motion measured in 29 of 30 frames" in (text := capsys.readouterr().out)
    found = api.measure(str(images), encoder=encoder, **LENS | {"K": [180, 180, 159.5, 44]})
    assert (found.table["valid"].sum(), found.files, found.doubts) == (29, [], [])
    with pytest.raises(TypeError, match=r"'camera_height': did you mean camera_height_m"):
        api.measure(images, encoder=encoder, camera_height=1.4)
    for name, value, limits in (
        ("wheelbase_m", 2700, r"wheelbase: .*less than or equal to 20 \(got 2700\)"),
        ("fov_deg", "65", r"fov: .*valid number \(got '65'\)"),
    ):
        with pytest.raises(InputError, match=limits):
            api.measure(images, encoder=encoder, **{name: value})
    assert (
        found.notes[1] == "motion measured in 29 of 30 frames; not measured: no previous frame (1)"
    )
    assert "can.csv covers 21 of 30 images" in text
    assert "times what is measured: km/h would give 3.6" in text
    rows = read(out)
    assert rows["valid"].tolist() == [0] + 29 * [1]
    assert rows["yaw_rate_radps"][1:] == pytest.approx(YAW_RATE, abs=0.02)
    assert rows["speed_mps"][1:] == pytest.approx(SPEED, rel=0.1)
    assert rows["measured_rad"][1:] == pytest.approx(np.arctan(2.7 * YAW_RATE / SPEED), abs=0.01)
    assert rows["heading_rad"][-1] == pytest.approx(2.9 * YAW_RATE, rel=0.1)
    # left
    assert rows["y_m"][-1] == pytest.approx(
        SPEED / YAW_RATE * (1 - np.cos(2.9 * YAW_RATE)), rel=0.2
    )
    quality = json.loads((out / "quality.json").read_text())
    assert quality["road_height_m"] == pytest.approx(CAMERA_HEIGHT_M, rel=0.1)
    assert quality["recorded"]["speed"]["gain"] == pytest.approx(3.6, rel=0.1)
    assert quality["comparison"]["frames"] == 20  # to the end of the log at 2 s
    assert quality["speed_sigma"] < 0.1
    with av.open(str(out / "overlay.mp4")) as file:
        assert sum(1 for _ in file.decode(video=0)) == 30


@pytest.mark.parametrize("kind", ["standing", "night", "snow"])
def test_input_without_motion_gets_no_numbers(tmp_path, encoder, kind, capsys):
    rng, shape = np.random.default_rng(0), (12, *street.WIDE.size, 3)
    view = drive(1)[0] if kind == "standing" else 3
    noisy = np.clip(view + rng.normal(0, 2, shape), 0, 255).astype(np.uint8)
    images = write_folder(
        tmp_path / "images", rng.integers(0, 255, shape, np.uint8) if kind == "snow" else noisy
    )
    measure([images], out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    rows = read(tmp_path / "out")
    assert not rows["valid"].any()
    for name in ("speed_mps", "yaw_rate_radps", "measured_rad", "x_m", "points"):
        assert np.isnan(rows[name]).all()
    text = capsys.readouterr().out
    assert "motion measured in 0 of 12 frames; not measured:" in text
    assert "horizon: not found" in text


def test_a_camera_that_looks_back_is_noticed(tmp_path, encoder, capsys):
    images, log = write_folder(tmp_path / "images", drive(12)[::-1]), tmp_path / "can.csv"
    measure([images], out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    assert (
        "11 of 11 moving frames are measured backwards: the camera looks back?"
        in capsys.readouterr().out
    )
    for speed, problem in (
        (-SPEED, nullcontext()),
        (SPEED, pytest.raises(InputError, match=r"forward by can\.csv")),
    ):
        rows = [f"{number / 10},{speed},{YAW_RATE}\n" for number in range(12)]
        log.write_text("time_s,speed_mps,yaw_rate_radps\n" + "".join(rows))
        with problem:
            measure(
                [images],
                out=tmp_path / f"{speed}",
                encoder=encoder,
                motion=log,
                video=False,
                **LENS,
            )


def test_a_cut_is_not_a_motion(tmp_path, encoder):
    before = [image[:, ::-1] for image in drive(10)]
    images = write_folder(tmp_path / "images", [*before, *drive(10, start=25)])
    measure([images], out=tmp_path / "out", encoder=encoder, video=False, **LENS)
    rows = read(tmp_path / "out")
    yaw_rate = rows["yaw_rate_radps"]
    assert rows["valid"].tolist() == [0, *9 * [1], 0, *9 * [1]]
    assert yaw_rate[1:6] == pytest.approx(-YAW_RATE, abs=0.02)  # mirrored
    assert yaw_rate[15:] == pytest.approx(YAW_RATE, abs=0.02)


def test_a_killed_run_leaves_nothing(tmp_path, encoder, monkeypatch):
    images = write_folder(tmp_path / "images", drive(4))
    monkeypatch.setattr(chain, "measure_drive", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        measure([images], out=tmp_path / "results/out", encoder=encoder, **LENS)
    assert [*(tmp_path / "results").iterdir()] == []


def test_an_imported_recording_has_the_same_numbers(tmp_path, encoder, monkeypatch):
    """A lens with distortion above the horizon: import and the stages measure what steer measure
    does.
    """
    monkeypatch.setattr(horizon, "MIN_PAIRS", 1)
    monkeypatch.setattr(preset, "PRESETS", tmp_path / "presets")
    monkeypatch.chdir(preset.ROOT)
    taller = [np.pad(image, [(70, 30), (0, 0), (0, 0)], mode="edge") for image in drive(14)]
    images, K, bent = (
        write_folder(tmp_path / "images", taller),
        "180,180,159.5,98",
        "-0.02,0.01,0,0",
    )
    options = RecordingOptions(K=K, distortion=bent, fps=10.0, camera_height=CAMERA_HEIGHT_M)
    opened = chain.open_source([images], READING, options)
    assert opened.camera.horizon == pytest.approx(114, abs=3)
    settings = Perception(batch=4)
    lens = {"distortion": bent, "camera_height_m": CAMERA_HEIGHT_M}
    other = write_folder(tmp_path / "other", taller[1:])
    import_recording([images, other], "monday", K=[K], fps=10.0, each=True, **lens)
    preset.main(str(tmp_path / "presets/monday.yaml"), tmp_path)
    files = [tmp_path / f"imported/{stage}.h5" for stage in ("ingest", "perception", "motion")]
    settings_of = load(Ingest, tmp_path / "params.yaml")
    with monkeypatch.context() as patch:
        patch.setattr(opening, "scan", None)  # import has decoded all images once
        imported = recording.open_drive("monday-1", settings_of, tmp_path / "data/raw")
    part = settings_of.recordings["monday-1"]
    # of an earlier version
    without = {name: value for name, value in part.files.items() if name != recording.SCAN}
    scanned = recording.open_part(
        part.model_copy(update={"files": without}), tmp_path / "data/raw/monday-1"
    )
    pd.testing.assert_frame_equal(
        scanned.scan,
        recording.open_part(part, tmp_path / "data/raw/monday-1").scan,
        check_exact=True,
    )
    write_drive(files[0], imported, "monday-1", "recording", READING)
    perceive_drive(files[1], files[0], encoder, settings)
    measure_drive(files[2], *files[:2])
    with chain.run_chain(opened, None, READING, settings, encoder) as work:
        stage, own = (DriveReader(path, stage="motion") for path in (files[2], work / "motion.h5"))
        assert stage["valid"].tolist() == own["valid"].tolist() == [0] + 13 * [1]
        for dataset in ("yaw_rate_radps", "speed_mps", "filtered_mps", "speed_sigma"):
            np.testing.assert_allclose(stage[dataset], own[dataset], rtol=1e-5)


def test_unsuitable_inputs(tmp_path, encoder, monkeypatch):
    images = write_folder(tmp_path / "images", drive(4))
    rotated = write_folder(tmp_path / "rotated", [np.rot90(view) for view in drive(2)])
    write(tmp_path / "kept/poses.txt", "mine")
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        measure([images], encoder=encoder, video=False, **LENS)
    for name in ("images", "images-2"):
        assert len(read(tmp_path / f"out/{name}")["frame"]) == 4
    for path, options, problem in (
        (images, {"encoder": tmp_path}, "no encoder"),
        (images, {"out": tmp_path / "kept"}, "exists already and holds poses.txt"),
        (rotated, {}, "taller than wide"),
        (images, {"video": False}, r"4 frames need up to 0\.0029 GB"),
    ):
        if "video" in options:
            monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=10**6))
        with pytest.raises(InputError, match=problem):
            measure([path], **{"encoder": encoder, **LENS, **options})
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["poses.txt"]
