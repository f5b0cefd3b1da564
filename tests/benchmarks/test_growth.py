"""The curves of growth: a step is measured at the size that was asked for."""

from pathlib import Path

import pytest

from benchmarks import growth
from benchmarks.rows import at_hand


@pytest.mark.real
@pytest.mark.slow
def test_a_step_is_of_the_points_and_frames_that_were_asked_for(real_kitti: Path, tmp_path: Path) -> None:
    street = at_hand.recorded(real_kitti, tmp_path, 500)
    assert len(street.arrays(1)["xyz"]) == 500
    seconds, peak_bytes = growth.step(street, growth.Setting(points=500, runs=2, window=4, equivariant=True), 1)
    assert seconds > 0
    assert peak_bytes > 100e6
    table = growth._table("window", [growth.Setting(points=500, window=2)], {500: street}, 1)
    assert "| 500 | 31 | 2 | no |" in table
