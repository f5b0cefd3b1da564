"""Stage labels: angles of each source, down to KITTI's own packets."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, read_index
from pipeline.ingest.packets import make_packets
from pipeline.labels.label_file import open_labels
from stages import labels
from tests.artefacts import write_index, write_motion, write_recorded
from tests.kitti_drive import write_params

DRIVES = {"2011_09_26_drive_0001": "train", "2011_09_26_drive_0002": "test"}
FIRST, SECOND = DRIVES


def write_ingest(folder: Path, speed: list[float], yaw_rate: list[float]) -> None:
    """Write two drives whose first frame is 5; the second is the first's mirror image."""
    for sign, drive in zip((1, -1), DRIVES, strict=True):
        oxts = make_packets(len(speed), vf=np.array(speed), wu=sign * np.array(yaw_rate))
        write_recorded(folder / f"{drive}.h5", np.arange(5, 5 + len(oxts)), oxts)
    write_index(folder, DRIVES)


def run(tmp_path: Path, **settings: Any) -> list[DriveReader]:
    params = write_params(tmp_path / "params.yaml", train=[FIRST], test=[SECOND], labels=settings)
    assert labels.main(tmp_path, params) == tmp_path / "labels"
    return [open_labels(tmp_path / f"labels/{drive}.h5") for drive in DRIVES]


def test_labels_of_two_drives(tmp_path, capsys):
    write_ingest(tmp_path / "ingest", speed=[10.0, 5.0, 0.2, -3.0], yaw_rate=[0.0, 0.5, 0.01, -0.3])
    left, right = run(tmp_path)
    expected = np.arctan([0.0, 2.7 * 0.5 / 5, 2.7 * 0.01 / 0.2, 2.7 * 0.1])
    np.testing.assert_allclose(left["steering_rad"], expected, atol=1e-15)
    np.testing.assert_array_equal(right["steering_rad"], -left["steering_rad"])
    np.testing.assert_array_equal(left["valid"], [1, 1, 0, 1])
    np.testing.assert_allclose(left["curvature_1pm"], np.tan(expected) / 2.7, atol=1e-15)
    np.testing.assert_array_equal(left.frame, [5, 6, 7, 8])
    assert read_index(tmp_path / "labels", stage="labels") == DRIVES
    assert "4 frames, 3 valid" in capsys.readouterr().out


@pytest.fixture
def recorded(tmp_path) -> Path:
    """Write a drive with recorded angles, and one with oxts, too; motion is measured in both."""
    frame = np.arange(5, 10)
    angles = {5: 0.1, 7: 0.2, 8: 0.3, 9: 0.4}
    oxts = make_packets(5, vf=np.array([10.0, 10, 0.5, 10, 10]), wu=0.1)
    write_recorded(tmp_path / f"ingest/{FIRST}.h5", frame, None, angles)
    write_recorded(tmp_path / f"ingest/{SECOND}.h5", frame, oxts, angles)
    motion = {5: (0, 0), 6: (5.0, 0.5), 8: (0.5, 0.5), 9: (0, 0)}
    for drive in DRIVES:
        write_motion(tmp_path / "motion", drive, motion, stands=[9])
    write_index(tmp_path / "ingest", DRIVES)
    return tmp_path


def test_measured_and_recorded_labels_are_valid_unless_the_car_is_slow_or_stands(recorded):
    speed_mps = [np.nan, 5, np.nan, 0.5, np.nan]
    for file in run(recorded, source="motion"):
        assert file.attrs["measured"] == 1
        expected_rad = np.arctan([0, 2.7 * 0.1, 0, 2.7, 0])
        np.testing.assert_allclose(file["steering_rad"], expected_rad, rtol=0.05)
        np.testing.assert_array_equal(file["valid"], [0, 1, 0, 0, 0])
        np.testing.assert_allclose(file["speed_mps"], speed_mps, rtol=0.05)  # filtered
    for file in run(recorded, source="motion", angle="recorded"):
        assert file.attrs["measured"] == 0
        np.testing.assert_array_equal(file["steering_rad"], [0.1, 0, 0.2, 0.3, 0.4])
        # 8 is measured, and slow; in 9 nothing moves
        np.testing.assert_array_equal(file["valid"], [1, 0, 1, 0, 0])
        # The angle of 7 is a target, but its speed is none: unknown is not 0.
        np.testing.assert_allclose(file["speed_mps"], speed_mps, rtol=0.05)
        # The yaw rate is that of the recorded angle, which 6 lacks.
        is_known = np.isfinite(file["yaw_rate_radps"])
        assert is_known.tolist() == [False, False, False, True, False]


@pytest.mark.parametrize("mode", ["posmode", "velmode", "orimode"])
def test_an_interpolated_packet_is_no_target_and_ends_the_path_ahead(tmp_path, mode):
    """A path of 5 m is that of five frames. A recorded angle does not need the packet."""
    frame = np.arange(30)
    interpolated_at_20 = {mode: np.where(frame == 20, -1.0, 4.0)}
    for drive in DRIVES:
        rows = make_packets(30, vf=11.0, wu=0.2, **interpolated_at_20)
        write_recorded(tmp_path / f"ingest/{drive}.h5", frame, rows, dict.fromkeys(range(30), 0.1))
        write_motion(tmp_path / "motion", drive, dict.fromkeys(range(30), (5.0, 0.1)))
    write_index(tmp_path / "ingest", DRIVES)

    curvatures_1pm = {"computed": 0.2 / 11, "recorded": np.tan(0.1) / 2.7}
    for source, angle, valid in (
        ("ingest", "computed", frame != 20),
        ("ingest", "recorded", frame >= 0),
        ("motion", "computed", frame >= 0),
    ):
        file, _ = run(tmp_path, source=source, angle=angle, ahead_m=[0, 5])
        np.testing.assert_array_equal(file["valid"], valid)
        if source == "ingest":
            has_path = file["ahead_valid"]
            assert np.flatnonzero(has_path).tolist() == [*range(15), *range(21, 25)]
            np.testing.assert_allclose(file["ahead_1pm"][has_path == 1], curvatures_1pm[angle])


def test_a_known_speed_without_a_yaw_rate_is_no_label(tmp_path):
    """The angle is computed from both, so it is neither valid nor NaN."""
    write_ingest(tmp_path / "ingest", speed=[10.0, 10.0, 10.0], yaw_rate=[0.1, np.nan, 0.1])
    for file in run(tmp_path, ahead_m=[0, 1]):
        np.testing.assert_array_equal(file["valid"], [1, 0, 1])
        assert np.isfinite(file["steering_rad"]).all()
        np.testing.assert_array_equal(file["speed_mps"], 10.0)
        assert np.isnan(file["yaw_rate_radps"]).tolist() == [False, True, False]
        assert not file["ahead_valid"].any()


@pytest.mark.parametrize("settings", [{}, {"angle": "recorded"}])
def test_a_source_that_a_drive_lacks(recorded, settings):
    problem = f"{FIRST}.h5: drive has no recorded speed.* Set labels.source: motion"
    with pytest.raises(InputError, match=problem):
        run(recorded, **settings)


def test_an_angle_that_a_drive_lacks(tmp_path):
    write_ingest(tmp_path / "ingest", speed=[5.0], yaw_rate=[0.0])
    with pytest.raises(InputError, match=r"no recorded angles .*Set labels\.angle: computed"):
        run(tmp_path, angle="recorded")
