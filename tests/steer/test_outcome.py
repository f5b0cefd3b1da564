"""Results of steer: course, truth, comparison."""

from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.log import logged_values, read_logs
from pipeline.ingest.packets import make_rows
from pipeline.ingest.settings import RecordingOptions
from pipeline.labels.label import Car, Labels
from steer.measure import READING
from steer.outcome import Results, Truth, read_course, read_truth
from tests.artefacts import write_motion

CAR = Car(2.7, 1.0)


def test_the_course_integrates_rates_and_stops_with_the_car(tmp_path):
    """Frames are 10 s apart: a gap of one frame ends the motion."""
    write_motion(
        tmp_path, "drive", {0: (0, 0), 1: (8.0, 0.02), 2: (8.0, 0.02), 3: (0, 0), 4: (0.5, 0.0)}
    )
    with DriveReader(tmp_path / "drive.h5", stage="motion") as motion:
        causal, unknown = (
            read_course(motion, CAR, look_ahead=False, height_known=known)
            for known in (True, False)
        )
    assert np.isnan(causal["speed_mps"]).tolist() == [True, False, False, True, False]
    assert causal["measured_rad"][1:3] == pytest.approx(np.arctan(2.7 * 0.02 / 8.0))
    assert np.isnan(causal["measured_rad"][4])  # below the minimum speed
    assert causal["heading_rad"][1:3] == pytest.approx([0.2, 0.4])
    assert causal["x_m"][1] == pytest.approx(80 * np.cos(0.1))
    assert causal["y_m"][1] == pytest.approx(80 * np.sin(0.1))
    assert causal["heading_rad"][4] == pytest.approx(0.4)
    assert (unknown["speed_sigma"][1:3] > 0.2).all()
    assert (unknown["measured_sigma_rad"][1:3] > causal["measured_sigma_rad"][1:3]).all()


@pytest.mark.parametrize(
    ("wheel", "motion", "expected_rad"),
    [
        (None, None, [np.nan, 0.1, np.nan, -0.2]),
        (None, "oxts", [np.arctan(2.7 * 0.05), np.nan, np.arctan(2.7 * 0.05), np.nan]),
        (
            None,
            "0.05,10,0.5\n0.25,20,0.5\n",
            [np.nan, np.arctan(1.35 / 12.5), np.arctan(1.35 / 17.5), np.nan],
        ),
        ("time_s,wheel_rad\n0.1,1.4\n0.3,0\n", None, [np.nan, 0.1, 0.05, 0]),
        (
            "time_s,wheel_rad\n0,1.4\n0.2,2.8\n",
            "0.05,10,0.5\n0.25,20,0.5\n",
            [0.1, 0.15, 0.2, np.nan],
        ),
    ],
)
def test_truth_is_that_of_the_logs_or_of_the_drive(tmp_path, wheel, motion, expected_rad):
    files = [tmp_path / "wheel.csv", tmp_path / "motion.csv"]
    recorded: dict[str, Any] = {"steering_rad": {1: 0.1, 3: -0.2}}
    if motion == "oxts":  # whose angles are unknown at standstill, and in interpolated packets
        packets = make_rows(
            4, vf=np.array([10, 0.5, 10, 10]), wu=0.5, velmode=np.array([0, 4, 4, -1])
        )
        motion, recorded = None, {"oxts": dict(enumerate(packets))}
    files[0].write_text(wheel or "")
    files[1].write_text(f"time_s,speed_mps,yaw_rate_radps\n{motion}")
    options = {"wheel": files[0], "steering_ratio": 14.0} if wheel else {}
    logs = read_logs(RecordingOptions(**options, motion=files[1] if motion else None))
    values = logged_values(logs, np.arange(4), np.arange(4) / 10) if logs else recorded
    drive = Drive(None, lambda: (Frame(number, number / 10) for number in range(4)), values)
    write_drive(tmp_path / "a.h5", drive, "a", "recording", READING)
    with DriveReader(tmp_path / "a.h5", stage="ingest") as raw:
        truth = read_truth(raw, raw.frame, logs, CAR)
    np.testing.assert_allclose(
        np.where(truth.driven.valid, truth.driven.steering_rad, np.nan), expected_rad
    )
    if motion:
        np.testing.assert_allclose(truth.driven.speed_mps, [np.nan, 12.5, 17.5, np.nan])
    names = [name for name, log in (("wheel.csv", wheel), ("motion.csv", motion)) if log]
    assert truth.name == (" and ".join(names) or ("oxts" if "oxts" in recorded else "steering.csv"))
    for path, offset_s, problem in (
        (files[0], 0, "--steering-ratio"),
        (None, 1, "--offset needs a log"),
    ):
        with pytest.raises(InputError, match=problem):
            read_logs(RecordingOptions(wheel=path, offset=offset_s))


def test_comparison_by_its_definition():
    """With the angle two frames later; the measured angle is held in frame 5, and not known in
    frame 0.
    """
    frame, driven_rad = np.arange(11), np.random.default_rng(0).normal(0, 0.1, 11)
    valid = ~np.isin(frame, [0, 5])
    table = {"frame": frame, "time_s": frame / 10, "measured_rad": np.where(valid, 0.2, np.nan)}
    table |= {"valid": valid.astype(np.uint8), "driven_rad": driven_rad}
    table["predicted_rad"] = np.where(frame < 3, np.nan, 0.05)
    labels = Labels(driven_rad, frame > -1, driven_rad, driven_rad)
    results = Results("drive", table, [""] * 11, Truth("log.csv", "wheel_rad", labels), {}, [], [])
    comparison = results.compare("predicted", 2)
    target = results.table["driven_rad"][5:]
    assert (comparison["truth"], comparison["frames"], comparison["horizon"]) == ("log.csv", 6, 2)
    for name, angle in (("predicted", 0.05), ("measured", 0.2), ("zero", 0.0)):
        error = ((angle - target) ** 2).mean()
        assert comparison[name]["nmse"] == pytest.approx(error / (target**2).mean())
        assert comparison[name]["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(error)))
    results.table["driven_rad"] = np.full(11, np.nan)
    assert results.compare("predicted") is None
