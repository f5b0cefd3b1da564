"""GPX and NMEA tracks: intact fixes only."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.recording.gnss import read_gpx, read_nmea
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
