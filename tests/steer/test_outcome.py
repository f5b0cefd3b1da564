"""Results of steer: the course, ground truth, and their comparison."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.log import Logs, logged_values, read_logs
from pipeline.ingest.packets import make_rows
from pipeline.ingest.settings import RecordingOptions
from pipeline.labels.label import Car, Labels
from pipeline.train.quantities.path import Target
from steer import pictures
from steer.measure import READING
from steer.outcome import Results, Truth, read_course, read_truth
from tests.artefacts import write_motion

CAR = Car(2.7, 1.0)


def test_the_recorded_track_begins_with_the_measured_one_and_ends_with_the_log():
    """The first measured step ends in frame 2, and the log ends in frame 4 of 6."""
    log_mps = np.array([10.0, 10, 10, 10, 10, np.nan])
    log = Labels(np.zeros(6), np.ones(6, bool), log_mps, np.zeros(6))
    x_m = np.array([np.nan, np.nan, 9, 18, 27, 36])
    table = {"time_s": np.arange(6.0), "x_m": x_m, "y_m": 0 * x_m}
    results: Any = SimpleNamespace(table=table, truth=Truth("can.csv", log))
    recorded_m = pictures._recorded_track(results)
    assert recorded_m is not None
    assert recorded_m.real.tolist()[:5] == [0, 0, 10, 20, 30]
    assert np.isnan(recorded_m[5])
    expected = "3.0 m from the recorded track after 30 m (10.0 %)"
    assert pictures._end_error(results, recorded_m) == expected


def test_the_course_integrates_rates_and_stops_with_the_car(tmp_path):
    """Frames are 10 s apart: a gap of one frame ends the motion."""
    rows = {0: (0, 0), 1: (8.0, 0.02), 2: (8.0, 0.02), 3: (0, 0), 4: (0.5, 0.0)}
    write_motion(tmp_path, "drive", rows)
    with DriveReader(tmp_path / "drive.h5", stage="motion") as motion:
        causal = read_course(motion, CAR, smooth=False)
    assert np.isnan(causal["speed_mps"]).tolist() == [True, False, False, True, False]
    assert causal["measured_rad"][1:3] == pytest.approx(np.arctan(2.7 * 0.02 / 8.0))
    assert np.isnan(causal["measured_rad"][4])  # below the minimum speed
    assert causal["heading_rad"][1:3] == pytest.approx([0.2, 0.4])
    assert causal["x_m"][1] == pytest.approx(80 * np.cos(0.1))
    assert causal["y_m"][1] == pytest.approx(80 * np.sin(0.1))
    assert causal["heading_rad"][4] == pytest.approx(0.4)


def truth_of(path: Path, values: dict[str, Any], logs: Logs) -> Truth:
    """Return the truth of four frames at 10 Hz with recorded or logged values."""
    frames = [Frame(number, number / 10) for number in range(4)]
    drive = Drive(None, lambda: iter(frames), values)
    write_drive(path, drive, path.stem, "recording", READING)
    with DriveReader(path, stage="ingest") as raw:
        return read_truth(raw, raw.frame, logs, CAR)


# Angles at standstill, and of interpolated packets, are unknown.
OXTS = make_rows(4, vf=np.array([10, 0.5, 10, 10]), wu=0.5, velmode=np.array([0, 4, 4, -1]))


@pytest.mark.parametrize(
    ("values", "name", "expected_rad"),
    [
        ({"steering_rad": {1: 0.1, 3: -0.2}}, "steering.csv", [np.nan, 0.1, np.nan, -0.2]),
        (
            {"oxts": dict(enumerate(OXTS))},
            "oxts",
            [np.arctan(2.7 * 0.05), np.nan, np.arctan(2.7 * 0.05), np.nan],
        ),
    ],
)
def test_truth_without_logs_is_what_the_drive_recorded(tmp_path, values, name, expected_rad):
    truth = truth_of(tmp_path / "a.h5", values, {})
    angles_rad = np.where(truth.driven.valid, truth.driven.steering_rad, np.nan)
    np.testing.assert_allclose(angles_rad, expected_rad)
    assert truth.name == name


SPEEDS = "time_s,speed_mps,yaw_rate_radps\n0.05,10,0.5\n0.25,20,0.5\n"


@pytest.mark.parametrize(
    ("files", "expected_rad"),
    [
        (
            {"motion.csv": SPEEDS},
            [np.nan, np.arctan(1.35 / 12.5), np.arctan(1.35 / 17.5), np.nan],
        ),
        ({"wheel.csv": "time_s,wheel_rad\n0.1,1.4\n0.3,0\n"}, [np.nan, 0.1, 0.05, 0]),
        (
            {"wheel.csv": "time_s,wheel_rad\n0,1.4\n0.2,2.8\n", "motion.csv": SPEEDS},
            [0.1, 0.15, 0.2, np.nan],
        ),
    ],
)
def test_truth_is_that_of_the_logs(tmp_path, files, expected_rad):
    options: dict[str, Any] = {}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        options[name.removesuffix(".csv")] = tmp_path / name
    if "wheel" in options:
        options["steering_ratio"] = 14.0
    logs = read_logs(RecordingOptions(**options))
    values = logged_values(logs, np.arange(4), np.arange(4) / 10)
    truth = truth_of(tmp_path / "a.h5", values, logs)
    angles_rad = np.where(truth.driven.valid, truth.driven.steering_rad, np.nan)
    np.testing.assert_allclose(angles_rad, expected_rad)
    if "motion" in options:
        np.testing.assert_allclose(truth.driven.speed_mps, [np.nan, 12.5, 17.5, np.nan])
    assert truth.name == " and ".join(files)


def test_options_that_belong_together(tmp_path):
    wheel = tmp_path / "wheel.csv"
    wheel.write_text("time_s,wheel_rad\n0,1.4\n0.2,2.8\n")
    with pytest.raises(InputError, match="--steering-ratio"):
        read_logs(RecordingOptions(wheel=wheel))
    with pytest.raises(InputError, match="--offset needs a log"):
        read_logs(RecordingOptions(offset=1))


def test_comparison_by_its_definition():
    """The truth is two frames later. The angle of frame 5 is held, that of frame 0 is unknown."""
    frame = np.arange(11)
    driven_rad = np.random.default_rng(0).normal(0, 0.1, 11)
    valid = ~np.isin(frame, [0, 5])
    table = {
        "frame": frame,
        "time_s": frame / 10,
        "valid": valid.astype(np.uint8),
        "driven_rad": driven_rad,
        "measured_rad": np.where(valid, 0.2, np.nan),
        "predicted_rad": np.where(frame < 3, np.nan, 0.05),
    }
    labels = Labels(driven_rad, frame > -1, driven_rad, driven_rad)
    truth = Truth("log.csv", labels)
    results = Results("drive", table, [""] * 11, truth, labels, {}, [], [])
    comparison = results.compare("predicted", 2)
    target = results.table["driven_rad"][5:]
    assert comparison["truth"] == "log.csv"
    assert comparison["frames"] == 6
    assert comparison["horizon"] == 2
    for name, angle in (("predicted", 0.05), ("measured", 0.2), ("zero", 0.0)):
        error = ((angle - target) ** 2).mean()
        assert comparison[name]["nmse"] == pytest.approx(error / (target**2).mean())
        assert comparison[name]["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(error)))
    results.table["driven_rad"] = np.full(11, np.nan)
    assert results.compare("predicted") is None


@pytest.mark.parametrize("recorded", [True, False])
def test_the_taken_path_is_recorded_or_else_measured(recorded):
    """At 10 m/s, the log turns by 1 rad/s to the left, and the images by 0.5."""
    frame = np.arange(8)
    known = np.ones(8, bool)
    speed_mps = np.full(8, 10.0)
    driven = Labels(np.zeros(8), known, speed_mps, np.full(8, 1.0))
    if not recorded:
        unknown = np.full(8, np.nan)
        driven = Labels(np.zeros(8), ~known, unknown, unknown)
    measured = Labels(np.zeros(8), known, speed_mps, np.full(8, 0.5))
    table = {"frame": frame, "time_s": frame / 10}
    results = Results("drive", table, [""] * 8, Truth("", driven), measured, {}, [], [])
    labels = {"wheelbase_m": 2.7, "min_speed_mps": 1.0, "ahead_m": [0.0, 2.0, 5.0]}
    results.add_prediction(Target(labels), np.zeros((8, 2)))

    (name,) = results.taken_1pm
    curvature_1pm = {"driven": 0.1, "measured": 0.05}[name]
    assert name == ("driven" if recorded else "measured")
    np.testing.assert_allclose(results.taken_1pm[name][0], curvature_1pm)
    assert np.isnan(results.taken_1pm[name][-2:]).all(), "the drive ends"
