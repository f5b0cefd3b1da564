"""Stage scores: measured motion is compared with what drives recorded, and with nothing else."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.camera.camera import Frame
from pipeline.kitti.ingest import ingest_drive
from pipeline.kitti.oxts import make_rows
from pipeline.labels.label import Car
from pipeline.settings.ingest import Reading
from stages import scores
from tests.artefacts import write_motion

DRIVE, FRAMES = "2027_03_31_drive_0001", 20
SPEED_MPS, YAW_RATE_RADPS = 10.0, 0.2
TRUE_RAD = float(np.arctan(2.7 * YAW_RATE_RADPS / SPEED_MPS))


def score(folder: Path, oxts: bool, wheel: bool) -> dict[str, dict[str, float] | None]:
    """Return the scores of a drive whose measured speed is 10 % too high, and whose recorded angle is 0.01 rad off."""
    ingest_drive(
        [Frame(number, number / 10) for number in range(FRAMES)],
        folder / f"ingest/{DRIVE}.h5",
        drive=DRIVE,
        camera=None,
        settings=Reading(image_size=(32, 32), cameras=[2], lidar=True, on_damaged="fail"),
        oxts=dict(enumerate(make_rows(FRAMES, vf=SPEED_MPS, wu=YAW_RATE_RADPS))) if oxts else None,
        steering_rad=dict.fromkeys(range(FRAMES), TRUE_RAD + 0.01) if wheel else None,
    )
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
def test_only_recorded_values_are_a_reference(tmp_path: Path, oxts: bool, wheel: bool, compared: set[str]) -> None:
    found = score(tmp_path, oxts, wheel)
    assert set(found) == compared
    for kind, result in found.items():
        assert result
        assert result["judged"] == FRAMES
        with_rates = kind == "visual"  # a wheel has neither speed nor yaw rate, whatever its labels borrow
        assert result["speed_ratio"] == (pytest.approx(1.1) if with_rates else None), kind
        assert (result["yaw_rmse_degps"] is None) == (not with_rates), kind
        assert 0 < result["nmse"] < 0.1
