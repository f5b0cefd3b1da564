"""The fit of a steering wheel's log: known numbers, and drives that do not tell them."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.camera.camera import Frame
from pipeline.ingest.drive import Drive
from pipeline.ingest.ingest_file import write_drive
from pipeline.ingest.log import TYPICAL_RATIO, Log, logged_values, read_logs
from pipeline.labels.label import Car
from steer import outcome
from steer.measure import READING
from steer.parameters import MeasureOptions
from steer.wheel_fit import fit_wheel
from tests.artefacts import WHEELBASE_M, write_motion

SPEED_MPS = 10.0
# Times of frames at 10 Hz, which are the ends of their steps.
TIME_S = np.arange(1200) / 10


def bends(time_s: np.ndarray, middles_s: np.ndarray) -> np.ndarray:
    """Return angles of the front wheels [F] that turn left and right in turn, by up to 0.1 rad."""
    sides = np.resize([0.1, -0.1], len(middles_s))
    return np.exp(-(((time_s[:, None] - middles_s) / 1.5) ** 2)) @ sides


def measure(
    middles_s: np.ndarray, noise_rad: float, speed_sigma: float, seed: int = 1
) -> dict[str, np.ndarray]:
    """Return measured columns with noise, and with errors of the speed that last for 2 s."""
    rng = np.random.default_rng(seed)
    angle_rad = bends(TIME_S - 0.05, middles_s)
    error = np.repeat(rng.normal(0, speed_sigma, len(TIME_S) // 20), 20)
    measured_rad = angle_rad * np.exp(error) + rng.normal(0, noise_rad, len(TIME_S))
    by_speed_rad = np.sin(2 * measured_rad) / 2 * speed_sigma
    return {
        "time_s": TIME_S,
        "measured_rad": measured_rad,
        "measured_sigma_rad": np.hypot(noise_rad, by_speed_rad),
        "speed_mps": np.full(len(TIME_S), SPEED_MPS),
        "speed_sigma": np.full(len(TIME_S), speed_sigma),
    }


def wheel_log(middles_s: np.ndarray, ratio: float, zero_rad: float, delay_s: float) -> Log:
    time_s = np.arange(-150, 6150) / 50
    wheel_rad = ratio * bends(time_s - delay_s, middles_s) + zero_rad
    return Log(time_s, wheel_rad[None] / TYPICAL_RATIO, ratio=TYPICAL_RATIO)


@pytest.mark.parametrize(
    ("ratio", "zero_rad", "delay_s", "noise_rad"),
    [(14.8, 0.05, 0.12, 0.002), (-20.0, -0.3, -0.43, 0.04)],
)
def test_known_numbers_are_found_with_intervals_as_wide_as_the_errors(
    ratio, zero_rad, delay_s, noise_rad
):
    """Noise as large as the angles does not make the ratio smaller."""
    middles_s = np.arange(4, 120, 7.3)
    log = wheel_log(middles_s, ratio, zero_rad, delay_s)
    errors = []  # of zero and delay in standard deviations, of which an interval has ± 1.96
    for seed in range(30):
        fit = fit_wheel(log, measure(middles_s, noise_rad, speed_sigma=0.04, seed=seed))
        # With the larger noise, the ratio is off by -0.7 ± 2.5 %, angles by 0.005 ± 0.002 rad, and
        # the interval is 21 ± 9 % wider than the error of the speed makes it.
        assert fit.ratio == pytest.approx(ratio, rel=0.11)
        low, high = fit.ratio_ci95
        assert high - low == pytest.approx(2 * 1.96 * 0.04 * abs(ratio), rel=0.6)
        angle_rad = fit.angle_rad(log, TIME_S)
        np.testing.assert_allclose(angle_rad, bends(TIME_S - 0.05, middles_s), atol=0.015)
        for known, (low, high) in ((zero_rad, fit.zero_rad_ci95), (delay_s, fit.delay_s_ci95)):
            errors.append(1.96 * (low + high - 2 * known) / (high - low))
    # Over groups of 30 seeds, 1.04 ± 0.13.
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_a_bend_in_a_single_stretch_tells_no_interval():
    middles_s = np.array([45.0])
    log = wheel_log(middles_s, 14.8, 0.05, 0.12)
    assert fit_wheel(log, measure(middles_s, noise_rad=0.01, speed_sigma=0.04)) is None


@pytest.mark.parametrize(("turn_rad", "ratio"), [(0.08, 16.0), (0.0, None)])
def test_results_have_the_fitted_angles_or_none(tmp_path, monkeypatch, turn_rad, ratio):
    """Frames are 10 s apart; the log is 0.3 s late, and 0.1 rad is straight ahead."""

    def angle_rad(time_s: np.ndarray) -> np.ndarray:
        return turn_rad * np.sin(time_s / 30) * np.sin(time_s / 71)

    # The motion of a frame is that in the middle of its step.
    rng = np.random.default_rng(0)
    frame = np.arange(150)
    noise_rad = rng.normal(0, 0.001, len(frame))
    yaw_radps = SPEED_MPS / WHEELBASE_M * np.tan(angle_rad(10.0 * frame - 5) + noise_rad)
    rows = {number: (SPEED_MPS, yaw_radps[number]) for number in frame.tolist()}
    write_motion(tmp_path, "motion", rows)

    log_s = np.arange(0, 1500, 0.25)
    wheel_rad = 16 * angle_rad(log_s - 0.3) + 0.1 + rng.normal(0, 0.001, len(log_s))
    lines = [f"{at_s},{angle}" for at_s, angle in zip(log_s, wheel_rad, strict=True)]
    wheel = tmp_path / "wheel.csv"
    wheel.write_text("\n".join(["time_s,wheel_rad", *lines]))
    logs = read_logs(MeasureOptions(wheel=wheel, steering_ratio="fit"))

    frames = [Frame(number, 10.0 * number) for number in frame.tolist()]
    drive = Drive(None, lambda: iter(frames), logged_values(logs, frame, 10.0 * frame))
    write_drive(tmp_path / "ingest.h5", drive, "drive", "recording", READING)
    monkeypatch.setattr(outcome, "facts_line", lambda name, summaries: "motion")
    camera = SimpleNamespace(height_known=True)
    source: Any = SimpleNamespace(
        path=Path("a.mp4"), name="a", logs=logs, drive=drive, camera=camera, doubts=[]
    )

    results = outcome.Results.read(
        source, tmp_path, Car(WHEELBASE_M, 1.0), smooth=True, fit_ratio=True
    )
    comparison = results.compare("measured")
    text = "\n".join(results.lines(comparison))
    if ratio is None:
        assert "the steering ratio cannot be fitted: the car turns too little" in text
        assert comparison is None
        assert results.doubts == []
    else:
        assert results.truth.wheel
        assert results.truth.wheel.ratio == pytest.approx(ratio, rel=0.05)
        # Over 20 seeds, 0.28 ± 0.06.
        assert results.truth.wheel.delay_s == pytest.approx(0.3, abs=0.27)
        assert "fitted to the measured motion, 95 % intervals: steering ratio 1" in text
        assert comparison
        assert comparison["truth"] == "wheel.csv (fitted to the measured motion)"
        assert comparison["measured"]["nmse"] < 0.01
