"""Visual odometry on a rendered street with exact depth."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.camera import classes
from pipeline.camera.camera import Frame
from pipeline.motion import step, visual
from tests import street

DT_S = 0.1


def views(*poses: np.ndarray) -> list[Frame]:
    images = (street.view(pose) for pose in poses)
    return [Frame(i, i * DT_S, image, depth_m, cls) for i, (image, depth_m, cls) in enumerate(images)]


def measured(frames: list[Frame], road_scale: bool = True) -> list[step.Step | None]:
    odometry = visual.Odometry(street.WIDE, road_scale=road_scale)
    return [odometry.step(frame) for frame in frames]


def rates(steps: list[step.Step | None]) -> np.ndarray:
    """Return yaw rate and speed [F-1,2]; all but the first must be measured."""
    assert steps[0] is None
    assert all(steps[1:])
    return np.array([step.rates(one.T_before, DT_S) for one in steps[1:] if one])


def rescaled(frames: list[Frame], road: float, elsewhere: float) -> list[Frame]:
    """Return frames whose depth is wrong by these factors."""
    factors = [np.where(frame.cls == classes.ROAD, road, elsewhere) for frame in frames]
    return [
        replace(frame, depth_m=frame.depth_m * factor)
        for frame, factor in zip(frames, factors, strict=True)
        if frame.depth_m is not None
    ]


@pytest.mark.parametrize(("yaw_rate", "speed"), [(0.4, 6.0), (-0.4, 6.0), (0.0, 12.0), (0.05, 1.0), (0.0, -2.0)])
def test_known_motion_is_measured(yaw_rate: float, speed: float) -> None:
    steps = measured(views(*street.arc(4, yaw_rate, speed)))
    assert rates(steps)[:, 0] == pytest.approx(yaw_rate, abs=0.005)
    assert rates(steps)[:, 1] == pytest.approx(speed, rel=0.02, abs=0.05)
    for one in steps[1:]:
        assert one
        assert one.inliers > 100
        assert one.residual < 0.4
        assert one.scale == pytest.approx(1, abs=0.02)


def test_a_wrong_scale_is_corrected_by_the_camera_height() -> None:
    frames = rescaled(views(*street.arc(4, 0.2, 6.0)), 0.7, 0.7)
    steps = measured(frames)
    assert rates(steps)[:, 1] == pytest.approx(6.0, rel=0.03)
    assert [one.scale for one in steps[1:] if one] == pytest.approx([1 / 0.7] * 3, rel=0.02)
    uncorrected = measured(frames, False)
    assert rates(uncorrected)[:, 1] == pytest.approx(0.7 * 6.0, rel=0.03)
    assert [one.scale for one in uncorrected[1:] if one] == [1.0] * 3
    assert rates(uncorrected)[:, 0] == pytest.approx(0.2, abs=0.01)


def test_traffic_is_excluded_by_its_class() -> None:
    """A bus ahead moves with the car and fills most of the view."""
    frames = views(*street.arc(3, 0.0, 6.0))
    bus = slice(10, 80), slice(60, 260)
    texture = np.random.default_rng(0).integers(0, 255, (70, 200, 1), dtype=np.uint8)
    for frame in frames:
        assert frame.image is not None
        assert frame.depth_m is not None
        assert frame.cls is not None
        frame.image[bus], frame.depth_m[bus], frame.cls[bus] = texture, 8.0, classes.BUS
    assert rates(measured(frames))[:, 1] == pytest.approx(6.0, rel=0.05)
    for frame in frames:
        assert frame.cls is not None
        frame.cls[bus] = classes.BUILDING
    assert not any(one and abs(step.rates(one.T_before, DT_S)[1] - 6) < 0.3 for one in measured(frames))
