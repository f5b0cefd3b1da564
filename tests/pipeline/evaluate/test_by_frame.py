"""predictions.csv has a row per frame; angles that do not exist are empty."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.evaluate import by_frame, decisions
from pipeline.evaluate.split import Case
from pipeline.train.labelled_drive import read_drives
from pipeline.train.predict import Prediction, Target
from tests import artefacts

NAMES = ["2026_01_03_drive_0001", "2026_01_03_drive_0002"]


def read(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()]


def test_a_row_per_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    artefacts.write_dataset(tmp_path, dict.fromkeys(NAMES, "test"), frames=9, points=20)
    artefacts.add_motion(tmp_path / f"graphs/semantic/{NAMES[0]}.h5", np.full(9, 0.25))
    drives = read_drives(tmp_path / "graphs/semantic", tmp_path / "labels", NAMES, 4)
    drives[1].valid[2] = False
    turns = {NAMES[0]: np.array([4], np.int32), NAMES[1]: np.empty(0, np.int32)}
    monkeypatch.setattr(decisions, "read_turns", lambda drive: decisions.Turns(turns[drive.name], turns[drive.name]))
    predicted = [Prediction(np.full(9, 0.5)), Prediction(np.r_[np.nan, np.full(8, -0.1234567)])]
    cases = [Case(drive, [seed], Target(0.0, 1.0, 2.7, 1.0)) for drive, seed in zip(drives, predicted, strict=True)]
    by_frame.write_predictions(tmp_path / "new/predictions.csv", cases, 0)
    head, *rows = read(tmp_path / "new/predictions.csv")
    assert ",".join(head) == "drive,frame,time_s,speed_mps,steering_rad,predicted_rad,valid,onset,odometry_rad"
    assert [row[0] for row in rows] == [NAMES[0]] * 9 + [NAMES[1]] * 9
    assert [row[1] for row in rows] == [str(number) for number in range(9)] * 2
    assert [row[5] for row in rows] == ["0.500000"] * 9 + [""] + ["-0.123457"] * 8
    assert [row[6] for row in rows] == ["1"] * 11 + ["0"] + ["1"] * 6
    assert [number for number, row in enumerate(rows) if row[7] == "1"] == [4]
    assert [row[8] for row in rows] == ["0.250000"] * 9 + [""] * 9
