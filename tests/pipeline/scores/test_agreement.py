"""Test how recorded values are compared with measured ones."""

from typing import Any

import numpy as np
import pytest

from pipeline.base import summary
from pipeline.motion.motion_file import YAW_NOISE_RADPS
from pipeline.scores import agreement
from pipeline.scores.agreement import Pair, SpeedPair
from pipeline.scores.recorded import Recorded, compare_drives, compare_recorded

WINDING_S = np.arange(0, 60, 0.1)


def winding(time_s: np.ndarray) -> np.ndarray:
    """Return the yaw rates of a winding road."""
    return 0.25 * np.sin(0.9 * time_s) + 0.15 * np.sin(2.3 * time_s + 1)


def pairs(recorded: np.ndarray, parts: int = 2) -> list[Pair]:
    """Return a log and the measured yaw rates of a winding road, as drives.

    Each ends with unmeasured frames.
    """
    drives = []
    for rows in np.array_split(np.arange(len(WINDING_S)), parts):
        measured = winding(WINDING_S[rows])
        measured[-3:] = np.nan
        turns = agreement.is_turning(measured, np.full(len(rows), YAW_NOISE_RADPS))
        drives.append(Pair(WINDING_S[rows], recorded[rows], measured, turns))
    return drives


LOGS: list[tuple[np.ndarray, dict[str, Any], bool]] = [
    (winding(WINDING_S), {"correlation": 1, "lag_s": 0, "gain": 1, "offset": 0}, False),
    (0.8 * winding(WINDING_S), {"gain": 0.8}, False),
    (0.6 * winding(WINDING_S), {"gain": 0.6}, True),
    (1.72 * winding(WINDING_S), {"gain": 1.72}, True),
    (winding(WINDING_S) + 0.02, {"offset": 0.02}, False),
    (winding(WINDING_S + 0.3), {"lag_s": -0.3, "correlation": 1}, False),
    (winding(WINDING_S - 0.35), {"lag_s": 0.35, "correlation": 1}, True),
    (winding(WINDING_S + 0.75), {"lag_s": -0.75, "correlation": 1}, True),
    (-winding(WINDING_S), {"correlation": -1, "lag_s": 0}, True),
    (np.degrees(winding(WINDING_S)), {"gain": 57.3}, True),
    (winding(WINDING_S) + 0.2, {"offset": 0.2}, True),
    (0 * WINDING_S, {"correlation": 0, "gain": 0}, True),
    (winding(WINDING_S[::-1] ** 1.1), {}, True),
]


@pytest.mark.parametrize(("recorded", "expected", "is_doubtful"), LOGS)
def test_a_log_is_described_by_numbers_and_at_most_one_doubt(recorded, expected, is_doubtful):
    facts = agreement.fit_log(pairs(recorded))
    assert facts
    for name, value in expected.items():
        assert getattr(facts, name) == pytest.approx(value, rel=0.01, abs=0.02)
    assert facts.frames == 594
    line = agreement.turns_line("yaw rate of log.csv", "rad/s", facts, advise=True)
    assert line.startswith("doubt: yaw rate of log.csv: corr") == is_doubtful
    assert ("--offset" in line) == bool(facts.lag_s)


@pytest.mark.parametrize(
    ("frames", "correlation", "is_doubtful"),
    [(39, 0.4, False), (40, 0.4, True), (40, -0.6, True), (40, 0.6, False), (99, 0.6, False)],
)
def test_a_log_of_few_turns_is_doubted_if_it_does_not_resemble_them(
    frames, correlation, is_doubtful
):
    facts = agreement.Follow(
        frames=200,
        turning=frames,
        correlation=correlation,
        lag_s=0.0,
        gain=1.0,
        offset=0.0,
        measured_rms=0.1,
        constant_s=0.0,
    )
    line = agreement.turns_line("angle", "rad", facts, advise=True)
    assert line.startswith(summary.DOUBT) == is_doubtful


def test_a_constant_log_counts_while_the_measured_motion_changes():
    """Values are held for 1.9 s. The car turns in the last 0.9 s, or its speed changes."""
    time_s = np.arange(30) / 10
    recorded = np.where(np.arange(30) < 20, 0.5, time_s)
    unknown = np.full(10, np.nan)
    turns = np.arange(30) >= 10
    measured = np.concatenate([np.zeros(10), np.full(20, 0.3)])
    assert Pair(time_s, recorded, measured, turns).constant_s() == pytest.approx(0.9)
    assert Pair(time_s, recorded, measured, np.zeros(30, bool)).constant_s() == 0
    assert Pair(time_s[:10], unknown, measured[:10], turns[10:20]).constant_s() == 0

    speed = SpeedPair(time_s, recorded, 8 + measured, np.full(30, 0.2))
    assert speed.constant_s() == pytest.approx(1.9)
    assert speed._replace(sigma=np.full(30, 0.4)).constant_s() == 0
    assert speed._replace(recorded=time_s).constant_s() == 0
    # Frames that are not measured tell nothing.
    late = np.where(np.arange(30) < 10, np.nan, 8 + measured)
    assert speed._replace(measured=late).constant_s() == 0


def test_a_straight_drive_or_no_frame_is_no_doubt():
    """Noise follows nothing, and a log that does not turn is not asked to."""
    noise = np.random.default_rng(0).normal(0, 0.001, (2, 300))
    straight = Pair(WINDING_S[:300], noise[0], noise[1], np.zeros(300, bool))
    facts = agreement.fit_log([straight])
    assert facts
    line = agreement.turns_line("angle", "rad", facts, advise=True)
    assert not line.startswith(summary.DOUBT)
    unknown = np.full(300, np.nan)
    assert agreement.fit_log([straight._replace(recorded=unknown)]) is None
    speed = SpeedPair(WINDING_S[:300], unknown, np.full(300, 8.0), np.full(300, 0.4))
    assert agreement.compare_speeds([speed]) is None


@pytest.mark.parametrize(
    ("recorded_mps", "height_known", "ratio", "contradicted", "is_doubtful"),
    [
        (10.0, True, 1.25, 10, True),
        (28.8, True, 3.6, 10, True),
        (28.8, False, 3.6, 3, False),
        (-8.0, True, 1.0, 287, True),
        (0.0, True, 0.0, 0, True),
    ],
)
def test_speeds_have_a_ratio_and_a_sign(
    recorded_mps, height_known, ratio, contradicted, is_doubtful
):
    """The car stands in the first second, and is measured backwards in some frames."""
    time_s = WINDING_S[:300]
    measured = np.where(np.arange(300) < 10, 0.1, 8.0)
    back = contradicted if recorded_mps > 0 else 290 - contradicted
    measured[10 : 10 + back] *= -1
    pair = SpeedPair(time_s, np.full(300, recorded_mps), measured, np.full(300, 0.4))
    facts = agreement.compare_speeds([pair])
    assert facts == agreement.Speed(290, pytest.approx(ratio), contradicted, pytest.approx(29.9))
    line = agreement.speed_line("speed", facts, height_known=height_known)
    assert line.startswith(summary.DOUBT) == is_doubtful


def recorded_drive(
    frames: int, *, start_s: float = 0.0, yaw_gain: float = 1.0, speed_gain: float = 1.0
) -> Recorded:
    """Return a drive on the winding road at 8 m/s, with logs that are wrong by a factor."""
    time_s = start_s + WINDING_S[:frames]
    yaw_rate = winding(time_s)
    turns = agreement.is_turning(yaw_rate, np.full(frames, YAW_NOISE_RADPS))
    speed_mps = np.full(frames, 8.0)
    return Recorded(
        yaw_rate=Pair(time_s, yaw_gain * yaw_rate, yaw_rate, turns),
        angle=Pair(time_s, np.full(frames, np.nan), yaw_rate, turns),
        speed=SpeedPair(time_s, speed_gain * speed_mps, speed_mps, 0.05 * speed_mps),
        height_known=True,
        one_clock=True,
    )


def test_a_wrong_log_among_many_is_doubted_by_the_name_of_its_drive():
    """Drives of 30 frames are judged alone, drives of 29 are counted."""
    drives = {f"drive_{row}": recorded_drive(40, start_s=5 * row) for row in range(20)}
    drives["sign"] = recorded_drive(30, yaw_gain=-1)
    drives["km/h"] = recorded_drive(30, speed_gain=3.6)
    drives["short"] = recorded_drive(29, yaw_gain=-1, speed_gain=3.6)
    recorded = compare_drives(drives, "test drives", advise=False)
    assert [*recorded] == [
        "yaw_rate of sign",
        "speed of km/h",
        "yaw_rate of test drives",
        "speed of test drives",
    ]
    assert recorded["yaw_rate of sign"]["line"].startswith("doubt: yaw rate of sign: corr")
    assert recorded["speed of km/h"]["line"].startswith("doubt: speed of km/h: 3.60 times")
    for quantity in ("yaw_rate", "speed"):
        pooled = recorded[f"{quantity} of test drives"]
        assert pooled["short_drives"] == 1
        assert pooled["line"].startswith(f"{quantity.replace('_', ' ')} of test drives (23): ")
        assert pooled["line"].endswith("30 frames, which are not judged alone: 1")

    # Without short drives, the line does not mention them.
    recorded = compare_drives({"drive_0": recorded_drive(30)}, "test drives", advise=False)
    assert recorded["speed of test drives"]["line"].endswith("while the measured one changes")


def test_several_files_have_no_common_offset():
    late = recorded_drive(300)
    late = late._replace(yaw_rate=late.yaw_rate._replace(recorded=winding(WINDING_S[:300] - 0.5)))
    for one_clock in (True, False):
        facts = compare_recorded([late._replace(one_clock=one_clock)], "log.csv")
        assert ("--offset -0.5" in facts["yaw_rate"]["line"]) == one_clock
