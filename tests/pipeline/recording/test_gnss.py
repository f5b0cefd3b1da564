"""GPX and NMEA tracks: intact fixes only."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.recording.gnss import read_gpx, read_nmea
from pipeline.recording.track import rates_of
from tests.gnss import START, bend, gpx, nmea, sentence


@pytest.fixture
def track(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "track"
        path.write_text(text)
        return path

    return write


def test_gpx_points(track: Callable[[str], Path]) -> None:
    time_s, places, _ = bend(6, 0.5)
    fixes = read_gpx(track(gpx(time_s, places)))
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(fixes.latitude_deg, places[:, 0], atol=1e-9)
    np.testing.assert_allclose(fixes.longitude_deg, places[:, 1], atol=1e-9)
    assert fixes.velocity_mps is None


def test_nmea_sentences(track: Callable[[str], Path]) -> None:
    time_s, places, heading = bend(6, 0.25)
    text = nmea(time_s, places, 9.0, heading)
    damaged = text.splitlines()[2].replace("A,4900", "A,4800")
    others = sentence("GPGGA,100000,4900.0,N,00824.0,E,1,08,0.9,545.4,M,46.9,M,,") + sentence("GNRMC,,V,,,,,,,,,,N")
    fixes = read_nmea(track(f"{others}{text}{damaged}\n$GNRMC,garbage\n"))
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(np.stack([fixes.latitude_deg, fixes.longitude_deg], -1), places, atol=1e-8)
    velocity = 9 * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    np.testing.assert_allclose(fixes.velocity_mps, velocity, atol=1e-3)


def test_a_stop_in_a_bend(track: Callable[[str], Path]) -> None:
    """The course is unknown while the car creeps; that is no turn to the north and back."""
    time_s = np.arange(200) / 10
    speed = np.clip(np.abs(time_s - 10) * 1.5 - 2, 0.3, 8)
    heading = np.pi + 0.05 * (np.cumsum(speed) - speed) / 10  # radius 20 m
    places = np.tile([49.0, 8.4], (200, 1))
    rates = rates_of(read_nmea(track(nmea(time_s, places, speed, heading))), Path("track"))
    moving = rates.speed_mps >= 1
    inner = moving & (np.abs(time_s - 10) < 9)
    assert 60 < inner.sum() < inner.size - 20
    np.testing.assert_allclose(rates.yaw_rate_radps[inner], 0.05 * speed[inner], atol=0.03)
