"""Files of measured motion: what the speed is after images are lost."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.camera.camera import Frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.settings import Reading
from pipeline.ingest.write import write_drive
from pipeline.motion import measure
from pipeline.motion.measure import measure_drive, time_contradiction
from pipeline.motion.motion_file import open_motion
from pipeline.perception.perceive import perceive_drive
from pipeline.perception.settings import Perception
from tests import street
from tests.flat_ground import write_encoder

READING = Reading(image_size=street.WIDE.size, cameras=[2], lidar=False, on_damaged="fail")
SPEED_MPS = 8.0
# Number of the first image that is lost.
LOST = 12


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    """Return the images of a drive at SPEED_MPS, every 0.1 s."""
    return [street.view(pose)[0] for pose in street.arc(36, 0.1, SPEED_MPS)]


def write_files(folder: Path, encoder: Path, images: list[np.ndarray]) -> tuple[Path, Path]:
    """Write the files of stages ingest and perception of a drive with a constant rate."""
    frames = [Frame(number, number / 10, image) for number, image in enumerate(images)]
    ingest = folder / "ingest.h5"
    perception = folder / "perception.h5"
    write_drive(ingest, Drive(street.WIDE, lambda: iter(frames)), "drive", "kitti", READING)
    perceive_drive(perception, ingest, encoder, Perception(batch=4))
    return ingest, perception


@pytest.mark.parametrize("lost", [1, 3, 10])
def test_lost_images_do_not_change_the_speed_after_them(tmp_path, monkeypatch, images, lost):
    """Times with a constant rate do not tell what is missing."""
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    files = write_files(tmp_path, encoder, images[:LOST] + images[LOST + lost :])
    summary = measure_drive(tmp_path / "motion.h5", *files)
    assert summary["moving_road_frames"] == summary["moving"] == 36 - lost - 1
    assert summary["contradiction_s"] == 0

    with open_motion(tmp_path / "motion.h5") as motion:
        assert motion["ratio"][LOST : LOST + 2].tolist() == [0, 0]
        for name in ("filtered_mps", "smooth_speed_mps"):
            speed_mps = motion[name][LOST + 1 :]
            assert speed_mps == pytest.approx(SPEED_MPS, rel=0.1), name


@pytest.mark.parametrize("name", ["filter_speeds", "smooth_rates"])
def test_a_contradiction_of_either_speed_is_in_the_summary(tmp_path, monkeypatch, images, name):
    encoder = write_encoder(tmp_path / "encoder", monkeypatch)
    files = write_files(tmp_path, encoder, images[:8])
    estimate = getattr(measure, name)

    def halve(*arguments: Any) -> Any:
        result = estimate(*arguments)
        return result._replace(speed_mps=result.speed_mps / 2)

    monkeypatch.setattr(measure, name, halve)
    summary = measure_drive(tmp_path / "motion.h5", *files)
    assert summary["contradiction_s"] == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("factors", "valid", "expected_s"),
    [
        ([1, 1, 0.6, 1.6, 1, 1], [1] * 6, 0.2),
        ([1, 1.4, 0.7, 1.4, 1, 1], [1] * 6, 0.0),
        # Frames without a road neither count nor end a contradiction.
        ([0.5, 1, 0.5, 0.5, 1, 0.5], [1, 0, 1, 0, 1, 1], 0.2),
        ([0.5] * 6, [0] * 6, 0.0),
    ],
)
def test_the_longest_contradiction_between_speed_and_depth_is_timed(factors, valid, expected_s):
    for by_depth_mps in (8.0, -8.0):
        speed_mps = np.full(6, by_depth_mps)
        is_valid = np.array(valid, bool)
        duration_s = np.full(6, 0.1)
        estimated_mps = np.array(factors) * speed_mps
        time_s = time_contradiction(estimated_mps, speed_mps, is_valid, duration_s)
        assert time_s == pytest.approx(expected_s)
