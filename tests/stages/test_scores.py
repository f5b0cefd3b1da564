"""Stage scores: of validation and test drives; motion is compared with what they recorded, and with nothing else."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.base import store
from pipeline.base.resume import ROOT
from pipeline.kitti.oxts import make_rows
from pipeline.labels.label import Car
from stages import scores
from tests import street
from tests.artefacts import write_motion, write_recorded

DRIVE, FRAMES = "2027_03_31_drive_0001", 20
SPEED_MPS, YAW_RATE_RADPS = 10.0, 0.2
TRUE_RAD = float(np.arctan(2.7 * YAW_RATE_RADPS / SPEED_MPS))


def score(folder: Path, oxts: bool, wheel: bool) -> dict[str, dict[str, float] | None]:
    """Return the scores of a drive whose measured speed is 10 % too high, and whose recorded angle is 0.01 rad off."""
    oxts = make_rows(FRAMES, vf=SPEED_MPS, wu=YAW_RATE_RADPS) if oxts else None
    angles = dict.fromkeys(range(FRAMES), TRUE_RAD + 0.01) if wheel else None
    write_recorded(folder / f"ingest/{DRIVE}.h5", np.arange(FRAMES), oxts, angles)
    write_motion(folder / "motion", DRIVE, dict.fromkeys(range(FRAMES), (1.1 * SPEED_MPS, YAW_RATE_RADPS)))
    return scores._score_motion([DRIVE], ingest=folder / "ingest", motion=folder / "motion", car=Car(2.7, 1.0))


@pytest.mark.parametrize(
    ("oxts", "wheel", "compared"),
    [
        (False, False, set()),
        (True, False, {"visual"}),
        (False, True, {"visual-wheel"}),
        (True, True, {"visual", "visual-wheel", "wheel"}),
    ],
)
def test_only_recorded_values_are_a_reference(tmp_path, oxts, wheel, compared):
    found = score(tmp_path, oxts, wheel)
    assert set(found) == compared
    for kind, result in found.items():
        assert result["judged"] == FRAMES
        with_rates = kind == "visual"  # a wheel has neither speed nor yaw rate, whatever its labels borrow
        assert result["speed_ratio"] == (pytest.approx(1.1) if with_rates else None), kind
        assert (result["yaw_rmse_degps"] is None) == (not with_rates), kind
        assert 0 < result["nmse"] < 0.1


def test_training_drives_have_no_scores(tmp_path):
    splits = {f"2026_01_01_drive_000{i}": split for i, split in enumerate(("train", "test"))}
    for drive in splits:
        street.write_drive(tmp_path / "ingest", drive, 3, dense=splits[drive] == "test")
        street.write_perception(tmp_path / "perception", tmp_path / "ingest", drive)
        write_motion(tmp_path / "motion", drive, dict.fromkeys(range(3), (8.0, 0.0)))
    store.write_index(tmp_path / "perception", splits)
    folders = [tmp_path / name for name in ("ingest", "perception", "motion", "scores")]
    out = scores.main(*folders, ROOT / "params.yaml", workers=1)
    found = store.read_json(out / "metrics.json", stage="scores")
    assert set(found["train"].values()) == {found["motion"]["visual"]["train"]} == {None}
    assert found["test"]["classes"]["frames"] == found["motion"]["visual"]["test"]["frames"] == 3
    assert not (out / next(iter(splits))).exists()
