"""Files of one recording, and their order, by their names."""

from pathlib import Path

import pytest

from pipeline.ingest.names import group, order_doubts

# Names in any order → those of each recording in order.
NAMES = {
    "part_10 part_9": ["part_9 part_10"],
    "2024-05-01_13-00-00-front 2024-05-01_12-59-00-front": [
        "2024-05-01_12-59-00-front 2024-05-01_13-00-00-front"
    ],
    "2024-05-01_12-00-00-back 2024-05-01_12-00-00-front": [
        "2024-05-01_12-00-00-back",
        "2024-05-01_12-00-00-front",
    ],
    "20240501_120000_EF 20240501_115900_NF": ["20240501_115900_NF 20240501_120000_EF"],
    "20240501_120000_NF 20240501_120000_NR": ["20240501_120000_NF", "20240501_120000_NR"],
    "NO20240501-120000-000001F NO20240501-120100-000002F": [
        "NO20240501-120000-000001F NO20240501-120100-000002F"
    ],
    "GX020042 GX010043 GX010042": ["GX010042 GX020042", "GX010043"],
    "GP010042 GP020042 GOPR0042": ["GOPR0042 GP010042 GP020042"],
    "DJI_0002 DJI_0001": ["DJI_0001 DJI_0002"],
    "DJI_20240501120000_0001_D DJI_20240501115000_0000_D": [
        "DJI_20240501115000_0000_D DJI_20240501120000_0001_D"
    ],
    "cam2_1 cam1_1 cam1_2 cam1_3": ["cam1_1 cam1_2 cam1_3", "cam2_1"],
    "12-59-00 13-00-00": ["12-59-00 13-00-00"],
}


@pytest.mark.parametrize(("names", "recordings"), NAMES.items())
def test_files_of_one_recording_differ_in_one_rising_number(names, recordings):
    grouped = []
    for paths in group([Path(f"{name}.mp4") for name in names.split()]).values():
        grouped.append(" ".join(path.stem for path in paths))
    assert sorted(grouped) == recordings


def test_files_of_two_cameras_that_take_turns_are_doubted():
    turns = [Path(f"{name}.mp4") for name in ("1_front", "1_back", "2_front", "2_back")]
    assert order_doubts(turns)[0].startswith("files of *_back.mp4 and *_front.mp4 take turns")
