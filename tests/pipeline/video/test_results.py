"""Results of measure and predict: course, truth, comparison, CSV, poses, pictures."""

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, Frame
from pipeline.kitti.ingest import ingest_drive
from pipeline.kitti.oxts import make_rows
from pipeline.labels.label import Car
from pipeline.motion.step import PROBLEMS
from pipeline.settings.ingest import Reading
from pipeline.video.log import Logs
from pipeline.video.pictures import write_overlay
from pipeline.video.results import Results, Truth, read_course, read_truth
from pipeline.video.source import Source
from tests.motion_files import write_motion

CAR, COUNT = Car(2.7, 1.0), 11
RADIUS_M, TURN_RAD = 10.0, np.pi / 2
READING = Reading(image_size=(32, 32), cameras=[2], lidar=False, on_damaged="fail")


def quarter() -> Results:
    """A quarter of a circle to the left; the first frame and the sixth are not measured."""
    heading = TURN_RAD * np.arange(COUNT) / 10
    valid = ~np.isin(np.arange(COUNT), [0, 5])
    place = RADIUS_M * np.sin(heading), RADIUS_M * (1 - np.cos(heading)), heading
    columns = dict(zip(("x_m", "y_m", "heading_rad"), place, strict=True)) | {"measured_rad": np.full(COUNT, 0.2)}
    columns |= {"speed_mps": np.full(COUNT, 5.0)}
    table = {name: np.where(valid, values, np.nan) for name, values in columns.items()}
    table |= {"frame": np.arange(COUNT), "time_s": np.arange(COUNT) / 10, "valid": valid.astype(np.uint8)}
    table["driven_rad"] = np.full(COUNT, 0.1)
    truth = Truth("log.csv", "wheel_rad", table["driven_rad"], np.full(COUNT, np.nan))
    return Results("drive", table, ["" if ok else PROBLEMS[4] for ok in valid], truth)


def test_the_course_integrates_rates_and_stops_with_the_car(tmp_path: Path) -> None:
    """Frames are 10 s apart: a gap of one frame ends the motion."""
    write_motion(tmp_path, "drive", {0: (0, 0), 1: (8.0, 0.02), 2: (8.0, 0.02), 3: (0, 0), 4: (0.5, 0.0)})
    with DriveReader(tmp_path / "drive.h5", stage="motion") as motion:
        causal, unknown = (read_course(motion, CAR, look_ahead=False, height_known=known) for known in (True, False))
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
        (None, "0.05,10,0.5\n0.25,20,0.5\n", [np.nan, np.arctan(1.35 / 12.5), np.arctan(1.35 / 17.5), np.nan]),
        ("frame,wheel_rad\n1,1.4\n3,-0.7\n", None, [np.nan, 0.1, np.nan, -0.05]),
        ("time_s,wheel_rad\n0,1.4\n0.2,2.8\n", "0.05,10,0.5\n0.25,20,0.5\n", [0.1, 0.15, 0.2, np.nan]),
    ],
)
def test_truth_is_that_of_the_logs_or_of_the_drive(
    tmp_path: Path, wheel: str | None, motion: str | None, expected_rad: list[float]
) -> None:
    frames, files = (
        [Frame(number, number / 10) for number in range(4)],
        [tmp_path / "wheel.csv", tmp_path / "motion.csv"],
    )
    recorded: dict[str, Any] = {"steering_rad": {1: 0.1, 3: -0.2}}
    if motion == "oxts":  # whose angles are unknown at standstill
        motion, recorded = None, {"oxts": dict(enumerate(make_rows(4, vf=np.array([10, 0.5, 10, 0.5]), wu=0.5)))}
    ingest_drive(frames, tmp_path / "a.h5", drive="a", camera=None, settings=READING, **recorded)
    files[0].write_text(wheel or "")
    files[1].write_text(f"time_s,speed_mps,yaw_rate_radps\n{motion}")
    logs = Logs.read(files[0] if wheel else None, 14.0 if wheel else None, files[1] if motion else None)
    with DriveReader(tmp_path / "a.h5", stage="ingest") as raw:
        truth = read_truth(raw, raw.frame, logs, CAR)
    np.testing.assert_allclose(truth.driven_rad, expected_rad)
    if motion:
        np.testing.assert_allclose(truth.driven_mps, [np.nan, 12.5, 17.5, np.nan])
    names = [name for name, log in (("wheel.csv", wheel), ("motion.csv", motion)) if log]
    assert truth.name == (" and ".join(names) or ("oxts" if "oxts" in recorded else "steering.csv"))
    with pytest.raises(InputError, match="--steering-ratio"):
        Logs.read(files[0], None, None)


def test_comparison_by_its_definition(tmp_path: Path) -> None:
    """With the angle two frames later; the measured angle is held where it is not known."""
    results, rng = quarter(), np.random.default_rng(0)
    driven = rng.normal(0, 0.1, COUNT)
    results.table["driven_rad"], results.table["predicted_rad"] = driven, np.where(np.arange(COUNT) < 3, np.nan, 0.05)
    comparison = results.compare("predicted", 2)
    assert comparison
    target = driven[5:]
    assert (comparison["truth"], comparison["frames"], comparison["horizon"]) == ("log.csv", 6, 2)
    for name, angle in (("predicted", 0.05), ("measured", 0.2), ("zero", 0.0)):
        error = ((angle - target) ** 2).mean()
        assert comparison[name]["nmse"] == pytest.approx(error / (target**2).mean())
        assert comparison[name]["rmse_deg"] == pytest.approx(np.rad2deg(np.sqrt(error)))
    results.table["driven_rad"] = np.full(COUNT, np.nan)
    assert results.compare("predicted") is None


def test_an_inverted_log_is_named() -> None:
    results = quarter()
    measured = results.table["measured_rad"] = np.sin(np.arange(COUNT) / 3)
    for sign in (1, -1):
        results.table["driven_rad"] = sign * measured
        text = "\n".join(results.lines(results.compare("measured")))
        assert ("the sign of wheel_rad is inverted: left is positive" in text) == (sign < 0)


@pytest.mark.parametrize("predicted", ["angle", "path", "none"])
def test_path_and_legend_are_inside_the_picture(tmp_path: Path, predicted: str) -> None:
    results, black = quarter(), np.zeros((188, 620, 3), np.uint8)
    if predicted != "none":
        results.table["predicted_rad"] = np.full(COUNT, 0.01 if predicted == "angle" else np.nan)
    if predicted == "path":
        results.ahead_m, results.path_1pm = (0, 10, 30), np.full((COUNT, 2), 0.01)
    camera = Camera(np.array([[360, 0, 305], [0, 360, 86], [0, 0, 1]]), (188, 620), 1.5)
    frames = [Frame(number, number / 10, black) for number in range(COUNT + 1)]  # the last one has no result
    source = Source(tmp_path, "drive", camera, lambda: iter(frames), None)
    write_overlay(tmp_path / "a.mp4", source, results, 2.7)
    with av.open(str(tmp_path / "a.mp4")) as file:
        images = [picture.to_ndarray(format="rgb24") for picture in file.decode(video=0)]
    assert len(images) == COUNT
    for image, measured in zip(images, results.table["valid"], strict=True):
        lit = image.max(axis=2) > 60
        assert lit[86:].any() or not measured  # the paths, below the horizon
        assert lit[:50].any()  # the legend
        assert not lit[:50, -8:].any()
    assert not black.any()  # the frame is not changed
