"""Results of steer: the course, ground truth, and their comparison."""

from typing import Any

import numpy as np
import pytest

from pipeline.camera.camera import Frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.packets import make_packets
from pipeline.ingest.write import write_drive
from pipeline.labels.label import Car
from pipeline.labels.label_file import Labels
from pipeline.motion.motion_file import open_motion
from steer import outcome, pictures, predict
from steer.measure import READING
from steer.outcome import Results, read_course
from tests import street
from tests.artefacts import write_motion

CAR = Car(2.7, 1.0)


def results_of(table: dict[str, Any], driven: Labels, measured: Labels | None = None) -> Results:
    return Results(
        table=table,
        problems=[],
        driven=driven,
        recorder="the log",
        measured=measured or driven,
        recorded={},
        facts={},
        notes=[],
        doubts=[],
    )


def test_the_driven_track_begins_with_the_measured_one_and_ends_with_the_log():
    """The first measured step ends in frame 2, and the log ends in frame 4 of 6."""
    log_mps = np.array([10.0, 10, 10, 10, 10, np.nan])
    log = Labels(np.zeros(6), np.ones(6, bool), log_mps, np.zeros(6))
    x_m = np.array([np.nan, np.nan, 9, 18, 27, 36])
    table = {"time_s": np.arange(6.0), "x_m": x_m, "y_m": 0 * x_m}
    driven_m = pictures.driven_track(results_of(table, log))
    np.testing.assert_array_equal(driven_m.real, [0, 0, 10, 20, 30, np.nan])


def test_the_course_integrates_rates_and_stops_with_the_car(tmp_path):
    """Frames are 10 s apart: a gap of one frame ends the motion."""
    rows = {0: (0, 0), 1: (8.0, 0.02), 2: (8.0, 0.02), 3: (0, 0), 4: (0.5, 0.0)}
    write_motion(tmp_path, "drive", rows)
    with open_motion(tmp_path / "drive.h5") as motion:
        causal = read_course(motion, CAR, smooth=False)
    assert np.isnan(causal["speed_mps"]).tolist() == [True, False, False, True, False]
    assert causal["measured_rad"][1:3] == pytest.approx(np.arctan(2.7 * 0.02 / 8.0))
    assert np.isnan(causal["measured_rad"][4])  # below the minimum speed
    assert causal["heading_rad"][1:3] == pytest.approx([0.2, 0.4])
    assert causal["x_m"][1] == pytest.approx(80 * np.cos(0.1))
    assert causal["y_m"][1] == pytest.approx(80 * np.sin(0.1))
    assert causal["heading_rad"][4] == pytest.approx(0.4)


# Angles at standstill, and of interpolated packets, are unknown.
OXTS = make_packets(4, vf=np.array([10, 0.5, 10, 10]), wu=0.5, velmode=np.array([0, 4, 4, -1]))


RATES = {
    "speed_mps": {0: 10.0, 1: 0.5, 2: 10.0},
    "yaw_rate_radps": {0: 0.5, 1: 0.5, 2: 0.5},
}


@pytest.mark.parametrize(
    ("values", "expected_rad"),
    [
        ({}, None),
        ({"steering_rad": {1: 0.1, 3: -0.2}}, [np.nan, 0.1, np.nan, -0.2]),
        (
            {"oxts": dict(enumerate(OXTS))},
            [np.arctan(2.7 * 0.05), np.nan, np.arctan(2.7 * 0.05), np.nan],
        ),
        (RATES, [np.arctan(2.7 * 0.05), np.nan, np.arctan(2.7 * 0.05), np.nan]),
        # Of a log of both, angles count, where the car moves as far as it is known.
        ({"steering_rad": dict.fromkeys(range(4), 0.1), **RATES}, [0.1, np.nan, 0.1, 0.1]),
    ],
)
def test_the_driven_angle_is_what_the_drive_recorded(tmp_path, values, expected_rad):
    frames = [Frame(number, number / 10) for number in range(4)]
    drive = Drive(street.CAMERA, lambda: iter(frames), values)
    write_drive(tmp_path / "a.h5", drive, "a", "kitti", READING)
    with open_ingest(tmp_path / "a.h5") as raw:
        driven = outcome._read_driven(raw, CAR)
    if driven is None:
        assert expected_rad is None
        return
    angles_rad = np.where(driven.valid, driven.steering_rad, np.nan)
    np.testing.assert_allclose(angles_rad, expected_rad)
    if "speed_mps" in values:
        np.testing.assert_array_equal(driven.yaw_rate_radps, [0.5, 0.5, 0.5, np.nan])


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
    results = results_of(table, labels)
    comparison = results.compare_angles("predicted", 2)
    target = results.table["driven_rad"][5:]
    assert comparison["truth"] == "the log"
    assert comparison["frames"] == 6
    assert comparison["horizon"] == 2
    for name, angle in (("predicted", 0.05), ("measured", 0.2)):
        error = ((angle - target) ** 2).mean()
        assert comparison[name]["nmse"] == pytest.approx(error / (target**2).mean())
        assert comparison[name]["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(error)))
    results.table["driven_rad"] = np.full(11, np.nan)
    assert results.compare_angles("predicted") is None


@pytest.mark.parametrize(
    ("recorded_mps", "name", "curvature_1pm"), [(10.0, "driven", 0.1), (np.nan, "measured", 0.05)]
)
def test_the_taken_path_is_recorded_or_else_measured(recorded_mps, name, curvature_1pm):
    """At 10 m/s, the log turns by 1 rad/s to the left, and the images by 0.5."""
    known = np.ones(8, bool)
    driven = Labels(np.zeros(8), known, np.full(8, recorded_mps), np.full(8, 1.0))
    measured = Labels(np.zeros(8), known, np.full(8, 10.0), np.full(8, 0.5))
    table = {"frame": np.arange(8), "time_s": np.arange(8) / 10}
    paths = predict.taken_path(results_of(table, driven, measured), [0.0, 2.0, 5.0])
    assert [*paths] == [name]
    np.testing.assert_allclose(paths[name][0], curvature_1pm)
    assert np.isnan(paths[name][-2:]).all(), "the drive ends"
