"""Stage labels, down to KITTI's own packets."""

import tarfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.store import DriveReader, DriveWriter, read_index
from pipeline.ingest.packets import interpolated, make_rows, recorded_motion
from stages import labels
from tests.artefacts import write_index, write_motion, write_recorded
from tests.kitti_drive import write_params

DRIVES = {"2011_09_26_drive_0001": "train", "2011_09_26_drive_0002": "test"}
FIRST, SECOND = DRIVES


def write_ingest(folder: Path, speed: list[float], yaw_rate: list[float]) -> None:
    """Write two drives whose first frame is 5; the second is the first's mirror image."""
    for sign, drive in zip((1, -1), DRIVES, strict=True):
        oxts = make_rows(len(speed), vf=np.array(speed), wu=sign * np.array(yaw_rate))
        write_recorded(folder / f"{drive}.h5", np.arange(5, 5 + len(oxts)), oxts)
    write_index(folder, DRIVES)


def run(tmp_path: Path, **settings: Any) -> list[DriveReader]:
    params = write_params(tmp_path / "params.yaml", train=[FIRST], test=[SECOND], labels=settings)
    assert labels.main(tmp_path, params) == tmp_path / "labels"
    return [DriveReader(tmp_path / f"labels/{drive}.h5", stage="labels") for drive in DRIVES]


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
    assert "4 frames, 3 valid, 2 turning" in capsys.readouterr().out


@pytest.fixture
def recorded(tmp_path) -> Path:
    """One drive with recorded angles and without oxts, one with both; motion is measured in
    both.
    """
    for drive in DRIVES:
        rows = (
            None if drive == FIRST else make_rows(5, vf=np.array([10.0, 10, 0.5, 10, 10]), wu=0.1)
        )
        angles = {5: 0.1, 7: 0.2, 8: 0.3, 9: 0.4}
        write_recorded(tmp_path / f"ingest/{drive}.h5", np.arange(5, 10), rows, angles)
        motion = {5: (0, 0), 6: (5.0, 0.5), 8: (0.5, 0.5), 9: (0, 0)}
        write_motion(tmp_path / "motion", drive, motion, stands=[9])
    write_index(tmp_path / "ingest", DRIVES)
    return tmp_path


def test_measured_and_recorded_labels_are_valid_unless_the_car_is_slow_or_stands(recorded):
    for file in run(recorded, source="visual"):
        np.testing.assert_allclose(
            file["steering_rad"], np.arctan([0, 2.7 * 0.1, 0, 2.7, 0]), rtol=0.02
        )
        np.testing.assert_array_equal(file["valid"], [0, 1, 0, 0, 0])
        np.testing.assert_allclose(file["speed_mps"], [0, 5, 0, 0.5, 0], rtol=0.02)  # filtered
    without, with_oxts = run(recorded, source="wheel")
    np.testing.assert_array_equal(without["steering_rad"], [0.1, 0, 0.2, 0.3, 0.4])
    # 8 is measured, and slow; in 9 nothing moves
    np.testing.assert_array_equal(without["valid"], [1, 0, 1, 0, 0])
    np.testing.assert_allclose(without["speed_mps"], [0, 5, 0, 0.5, 0], rtol=0.02)
    np.testing.assert_array_equal(with_oxts["valid"], [1, 0, 0, 1, 1])
    np.testing.assert_array_equal(with_oxts["speed_mps"], [10, 10, 0.5, 10, 10])


@pytest.mark.parametrize("mode", ["posmode", "velmode", "orimode"])
def test_an_interpolated_packet_is_no_target_and_ends_the_path_ahead(tmp_path, capsys, mode):
    """A path of 5 m is that of five frames. A recorded angle does not need the packet."""
    frame = np.arange(30)
    for drive in DRIVES:
        rows = make_rows(30, vf=11.0, wu=0.2, **{mode: np.where(frame == 20, -1.0, 4.0)})
        write_recorded(tmp_path / f"ingest/{drive}.h5", frame, rows, dict.fromkeys(range(30), 0.1))
        write_motion(tmp_path / "motion", drive, dict.fromkeys(range(30), (5.0, 0.1)))
    write_index(tmp_path / "ingest", DRIVES)
    for source, valid in {
        "recorded": frame != 20,
        "wheel": frame >= 0,
        "visual": frame >= 0,
    }.items():
        file, _ = run(tmp_path, source=source, ahead_m=[0, 5])
        np.testing.assert_array_equal(file["valid"], valid)
        text = f"{valid.sum()} valid, {valid.sum()} turning, {int(source != 'visual')} interpolated"
        assert text in capsys.readouterr().out
        if source != "visual":
            assert np.flatnonzero(file["ahead_valid"]).tolist() == [*range(15), *range(21, 25)]
            curvature_1pm = np.tan(0.1) / 2.7 if source == "wheel" else 0.2 / 11
            np.testing.assert_allclose(file["ahead_1pm"][file["ahead_valid"] == 1], curvature_1pm)


@pytest.mark.real
def test_interpolated_packets_of_kitti(real_kitti, tmp_path):
    packets, counts = defaultdict[str, list[Any]](list), dict[str, int]()
    with tarfile.open(real_kitti / "oxts.tar.gz") as archive:
        for member in archive:
            if "/data/0" in member.name:
                packets[member.name[11:32]].append(archive.extractfile(member).read().split())  # type: ignore[union-attr]
    for drive, rows in packets.items():
        with DriveWriter(
            tmp_path / f"ingest/{drive}.h5", stage="ingest", drive=drive, params={}
        ) as file:
            numbered = dict(enumerate(np.array(rows, float)))
            values = {
                name: [*column.values()] for name, column in recorded_motion(numbered).items()
            }
            values |= {"frame": range(len(rows)), "time_s": np.arange(len(rows)) / 10, "oxts": rows}
            for name, column in values.items():
                file.put(name, np.array(column, float))
    write_index(tmp_path / "ingest", dict.fromkeys(packets, "train"))
    run(tmp_path, ahead_m=[0, 0.1])
    for drive, rows in packets.items():
        guessed = interpolated(np.array(rows, float))
        counts[drive], file = (
            guessed.sum(),
            DriveReader(tmp_path / f"labels/{drive}.h5", stage="labels"),
        )
        assert not (file["valid"] | file["ahead_valid"][:, 0])[guessed].any()
    assert (len(counts), sum(counts.values()), counts["2011_10_03_drive_0027"]) == (55, 323, 134)


def test_an_inverted_wheel_is_refused_and_test_drives_are_not_compared(tmp_path, capsys):
    frame, angle = np.arange(1, 151), 0.1 * np.sin(np.arange(150) / 9)
    for drive, sign in zip(DRIVES, (1, -1), strict=True):
        recorded = dict(zip(frame.tolist(), sign * angle, strict=True))
        write_recorded(tmp_path / f"ingest/{drive}.h5", frame, None, recorded)
        motion = {
            number: (8.0, 8 * np.tan(rad) / 2.7)
            for number, rad in zip(frame.tolist(), angle, strict=True)
        }
        write_motion(tmp_path / "motion", drive, motion)
    write_index(tmp_path / "ingest", DRIVES)
    run(tmp_path, source="wheel")
    assert (
        f"{FIRST}: recorded / measured, 147 turning frames: angle gain 1.00"
        in capsys.readouterr().out
    )
    for split in ("val", "test"):  # leave-one-out has test drives only
        write_index(tmp_path / "ingest", {FIRST: "test", SECOND: split})
        with pytest.raises(InputError, match=f"{SECOND}: the sign of steering_rad is inverted"):
            run(tmp_path, source="wheel")


def test_a_split_whose_only_drive_stands_is_named(tmp_path, capsys):
    """Before stage train refuses it, minutes later."""
    write_ingest(tmp_path / "ingest", speed=[5.0] * 9 + [0.1], yaw_rate=[0.1] * 10)
    run(tmp_path)
    text = capsys.readouterr().out
    assert ("have a label" in text, "9 of 10 frames of split test turn" in text) == (False, True)
    write_ingest(tmp_path / "ingest", speed=[5.0] + [0.1] * 9, yaw_rate=[0.1] * 10)
    run(tmp_path)
    assert f"1 of 10 frames of {SECOND} have a label: the car stands?" in capsys.readouterr().out


def test_a_source_that_a_drive_lacks(recorded):
    with pytest.raises(InputError, match=r"no labels\.source: recorded"):
        run(recorded, source="oxts")
    write_ingest(recorded / "ingest", speed=[5.0], yaw_rate=[0.0])
    with pytest.raises(InputError, match=r"steering\.csv"):
        run(recorded, source="wheel")
