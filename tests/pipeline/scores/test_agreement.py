"""Test how recorded values are compared with measured ones."""

from typing import Any

import numpy as np
import pytest

from pipeline.base import console
from pipeline.motion.rates import YAW_NOISE_RADPS
from pipeline.scores import agreement
from pipeline.scores.agreement import Pair

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
    (0.6 * winding(WINDING_S), {"gain": 0.6}, False),
    (winding(WINDING_S) + 0.02, {"offset": 0.02}, False),
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
    line = agreement.turns_line("yaw rate of log.csv", "rad/s", facts)
    assert line.startswith("doubt: yaw rate of log.csv: corr") == is_doubtful


def test_a_straight_drive_or_no_frame_is_no_doubt():
    """Noise follows nothing, and a log that does not turn is not asked to."""
    noise = np.random.default_rng(0).normal(0, 0.001, (2, 300))
    straight = Pair(WINDING_S[:300], noise[0], noise[1], np.zeros(300, bool))
    facts = agreement.fit_log([straight])
    assert facts
    assert not agreement.turns_line("angle", "rad", facts).startswith(console.DOUBT)
    unknown = straight._replace(recorded=np.full(300, np.nan))
    assert agreement.fit_log([unknown]) is None
    assert agreement.compare_speeds([unknown]) is None


@pytest.mark.parametrize(
    ("recorded_mps", "height_known", "ratio", "contradicted", "is_doubtful"),
    [
        (10.0, True, 1.25, 10, True),
        (28.8, True, 3.6, 10, True),
        (28.8, False, 3.6, 3, False),
        (-8.0, True, 1.0, 287, True),
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
    pair = Pair(time_s, np.full(300, recorded_mps), measured, np.zeros(300, bool))
    facts = agreement.compare_speeds([pair])
    assert facts == agreement.Speed(290, pytest.approx(ratio), contradicted)
    line = agreement.speed_line("speed", facts, height_known=height_known)
    assert line.startswith(console.DOUBT) == is_doubtful
