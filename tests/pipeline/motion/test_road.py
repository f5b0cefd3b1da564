"""A flat road in front of a camera: direction of travel and scale of depth."""

import numpy as np
import pytest

from pipeline.motion.road import Road
from tests import street

_, DEPTH_M, _ = street.view(street.pose(0, 0, 0))
USABLE = DEPTH_M > 0


def step(down_m: float, ahead_m: float) -> np.ndarray:
    T_before = np.eye(4)
    T_before[1:3, 3] = down_m, ahead_m
    return T_before


def road(*steps: np.ndarray) -> Road:
    made = Road(street.WIDE, road_scale=True)
    for one in steps:
        made.add_step(one)
    return made


def test_the_slope_is_weighted_by_length() -> None:
    assert road().slope == 0
    assert road(*[step(0.02, 1.0)] * 50).slope == pytest.approx(50 * 0.02 / (50 + 10))
    assert road(*[step(0.02, 1.0)] * 9, step(0.5, 10.0)).slope == pytest.approx(0.68 / 29)
    forth, back = road(*[step(0.02, 1.0)] * 9), road(*[step(-0.02, -1.0)] * 9)
    assert forth.slope == back.slope > 0


def test_scale_corrects_depth_if_the_height_is_given() -> None:
    assert road().find(DEPTH_M / 2, USABLE)[1] == pytest.approx(2, rel=0.01)
    found, scale = Road(street.WIDE, road_scale=False).find(DEPTH_M / 2, USABLE)
    assert found.any()
    assert scale == 1
