"""GPX and NMEA tracks: the fixes that are there, and no more."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.recording.gnss import read_gpx, read_nmea
from tests.gnss import START, bend, gpx, nmea, sentence

FILE = Path("track")


def test_gpx_points() -> None:
    time_s, places, _ = bend(6, 0.5)
    fixes = read_gpx(gpx(time_s, places), FILE)
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(fixes.latitude_deg, places[:, 0], atol=1e-9)
    np.testing.assert_allclose(fixes.longitude_deg, places[:, 1], atol=1e-9)
    assert fixes.velocity_mps is None


def test_gpx_with_speeds_and_without_some_times() -> None:
    point = '<trkpt lat="49" lon="8"><time>2027-03-31T10:00:0{}</time><course>{}</course><speed>2</speed></trkpt>'
    text = (
        '<gpx version="1.0" creator="test" xmlns="http://www.topografix.com/GPX/1/0"><trk><trkseg>'
        + point.format("1", 90)  # without a zone: UTC
        + '<trkpt lat="49" lon="8"/>'
        + point.format("2Z", 0)
        + point.format("2Z", 0)  # twice
        + "</trkseg></trk></gpx>"
    )
    fixes = read_gpx(text, FILE)
    np.testing.assert_array_equal(fixes.time_s - START.timestamp(), [1, 2])
    np.testing.assert_allclose(fixes.velocity_mps, [[2, 0], [0, 2]], atol=1e-12)


def test_nmea_sentences() -> None:
    time_s, places, heading = bend(6, 0.25)
    text = nmea(time_s, places, 9.0, heading)
    damaged = text.splitlines()[2].replace("A,4900", "A,4800")
    others = sentence("GPGGA,100000,4900.0,N,00824.0,E,1,08,0.9,545.4,M,46.9,M,,") + sentence("GNRMC,,V,,,,,,,,,,N")
    fixes = read_nmea(f"{others}{text}{damaged}\n$GNRMC,garbage\n", FILE)
    np.testing.assert_allclose(fixes.time_s, START.timestamp() + time_s)
    np.testing.assert_allclose(fixes.latitude_deg, places[:, 0], atol=1e-8)
    np.testing.assert_allclose(fixes.longitude_deg, places[:, 1], atol=1e-8)
    velocity = 9 * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    np.testing.assert_allclose(fixes.velocity_mps, velocity, atol=1e-3)


def test_a_standing_car_has_no_course() -> None:
    time_s, places, heading = bend(3, 1.0)
    velocity = read_nmea(nmea(time_s, places, 0.0, heading), FILE).velocity_mps
    np.testing.assert_array_equal(velocity, np.zeros((3, 2)))
    without_course = nmea(time_s, places, 0.0, heading).replace(",0.0000,,", ",9.0000,,")
    lines = "".join(sentence(line[1:].partition("*")[0]) for line in without_course.splitlines())
    assert read_nmea(lines, FILE).velocity_mps is None  # it moves: positions have to say where


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (read_gpx, "<html></html>", "track has no points with a time"),
        (read_gpx, "<gpx", "track is not a GPX file: Error parsing XML"),
        (read_nmea, sentence("GNRMC,,V,,,,,,,,,,N"), "track has no RMC sentences with a fix"),
    ],
)
def test_no_track(read, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(text, FILE)


@pytest.mark.parametrize(("library", "read"), [("gpxpy", read_gpx), ("pynmea2", read_nmea)])
def test_a_library_that_is_not_installed(monkeypatch: pytest.MonkeyPatch, library: str, read) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=rf"read by {library}, which is not installed: pip install -e '\.\[gps\]'"):
        read("", FILE)
