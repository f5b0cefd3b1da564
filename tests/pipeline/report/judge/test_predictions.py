"""predictions.csv and the diagram: every frame is there, what nobody knows stays empty, files repeat bit by bit."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.report.judge import decisions, predictions, steering_plot
from pipeline.train import windows
from tests import artefacts

NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


@pytest.fixture
def drives(tmp_path: Path) -> list[windows.Drive]:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=9, points=20)
    return windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4)


def test_a_row_for_each_frame(tmp_path: Path, drives: list[windows.Drive], monkeypatch: pytest.MonkeyPatch) -> None:
    drives[1].valid[2] = False
    monkeypatch.setattr(decisions, "frames", lambda drive: np.array([4] if drive is drives[0] else [], np.int32))
    predicted = [np.full(9, 0.5), np.r_[np.nan, np.full(8, -0.1234567)]]
    predictions.write(tmp_path / "new/predictions.csv", list(zip(drives, predicted, strict=True)))
    head, *rows = [line.split(",") for line in (tmp_path / "new/predictions.csv").read_text().splitlines()]
    assert head == ["drive", "frame", "time_s", "speed_mps", "steering_rad", "predicted_rad", "valid", "onset"]
    assert [row[0] for row in rows] == [NAMES[0]] * 9 + [NAMES[1]] * 9
    assert [row[1] for row in rows] == [str(number) for number in range(9)] * 2
    assert [row[5] for row in rows] == ["0.500000"] * 9 + [""] + ["-0.123457"] * 8
    assert [row[6] for row in rows] == ["1"] * 11 + ["0"] + ["1"] * 6
    assert [number for number, row in enumerate(rows) if row[7] == "1"] == [4]


def test_with_a_horizon_a_row_is_the_last_frame_seen_and_the_angle_to_come(tmp_path: Path) -> None:
    artefacts.write_dataset(tmp_path, {NAMES[0]: "test"}, frames=9, points=20)
    (drive,) = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES[:1], 4, 3)
    (now,) = windows.read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES[:1], 4)
    predictions.write(tmp_path / "predictions.csv", [(drive, np.zeros(9))])
    rows = [line.split(",") for line in (tmp_path / "predictions.csv").read_text().splitlines()[1:]]
    assert [row[1] for row in rows] == [str(number) for number in range(9)]
    assert [float(row[4]) for row in rows[:6]] == pytest.approx(now.steering_rad[3:], abs=1e-9)
    assert [(row[4], row[6]) for row in rows[6:]] == [("", "0")] * 3  # of what comes later nothing was recorded
    steering_plot.draw(tmp_path / "ahead.png", [(drive, np.zeros(9))], "net")


def test_the_diagram_is_the_same_file_each_time(tmp_path: Path, drives: list[windows.Drive]) -> None:
    for name in ("a.png", "b.png"):
        steering_plot.draw(tmp_path / name, [(drive, np.zeros(9)) for drive in drives], "net")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
