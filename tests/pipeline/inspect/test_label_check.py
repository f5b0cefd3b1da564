"""Labels that no car drives are told; those of real drives are not."""

import tarfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from pipeline.inspect.label_check import implausible, impossible, summary
from pipeline.kitti.oxts import COLUMNS, make_rows

TIMES = np.arange(30) * 0.1


def test_a_plain_drive_is_plausible() -> None:
    rows = make_rows(30, vf=np.linspace(2, 20, 30), wu=0.2, vl=0.3)
    assert (impossible(rows), implausible(rows, TIMES)) == ([], [])
    assert summary(rows) == {"speed_mps": [2.0, 20.0], "yaw_rate_radps": [0.2, 0.2]}
    empty = make_rows(0)
    assert (impossible(empty), implausible(empty, TIMES[:0]), summary(empty)) == ([], [], {})


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"vf": 5.0, "wu": 700.0}, "turns at up to 700 rad/s in 30 of 30 frames"),
        ({"vf": 25.0, "wu": -0.6}, "bends with up to 15 m/s² to the side"),
        ({"vf": 90.0}, "drives at up to 90 m/s"),
        ({"vf": 1e300, "wu": 1e300}, "turns at up to 1e"),
    ],
)
def test_what_no_car_does(columns: dict[str, float], said: str) -> None:
    assert said in impossible(make_rows(30, **columns))[0]


def test_what_deserves_a_look() -> None:
    speed = np.full(30, 5.0)
    speed[:4] = -2
    told = implausible(make_rows(30, vf=speed, vl=np.where(np.arange(30) < 7, 3.0, 0)), np.cumsum(TIMES))
    assert told == [
        "moves sideways at up to 3 m/s: its heading is wrong, better leave it out (7 of 30 frames)",
        "drives backwards at up to 2 m/s (4 of 30 frames)",
        "its time jumps by 2.9 s",
    ]
    assert implausible(make_rows(30), None) == ["stands still all the time: it has no valid label"]


@pytest.mark.real
@pytest.mark.slow
def test_of_all_real_drives_the_one_with_a_wrong_heading_is_told(real_kitti: Path) -> None:
    packets = defaultdict(list)
    with tarfile.open(real_kitti / "oxts.tar.gz") as archive:
        for member in archive:
            if member.name.endswith(".txt") and "/data/" in member.name:
                file = archive.extractfile(member)
                assert file is not None
                packets[member.name.split("/")[1]].append(np.array(file.read().split(), float))
    rows = {drive: np.array(of).reshape(-1, len(COLUMNS)) for drive, of in packets.items()}
    assert len(rows) > 50
    assert not [drive for drive, of in rows.items() if impossible(of)]
    sideways = [drive for drive, of in rows.items() if any("sideways" in why for why in implausible(of, None))]
    assert sideways == ["2011_09_26_drive_0093_sync"]
