from pipeline.report.tables.motion_table import markdown

CARD = {
    "drives": 2, "frames": 153, "valid": 0.99, "judged": 140,
    "yaw_rmse_degps": 0.16, "yaw_median_degps": 0.11, "speed_ratio": 0.977,
}  # fmt: skip


def test_each_kind_and_split_that_was_judged_has_a_row() -> None:
    cards = {
        "lidar": {"train": None, "val": None, "test": {**CARD, "nmse": 0.0005}},
        "visual": {"train": {**CARD, "nmse": None}, "val": None, "test": {**CARD, "nmse": 0.13}},
    }
    rows = [line for line in markdown(cards).splitlines() if line.startswith(("| lidar", "| visual"))]
    assert rows == [
        "| lidar | test | 2 | 153 | 99.0% | 140 | 0.160 | 0.110 | 0.977 | 0.0005 |",
        "| visual | train | 2 | 153 | 99.0% | 140 | 0.160 | 0.110 | 0.977 | none |",
        "| visual | test | 2 | 153 | 99.0% | 140 | 0.160 | 0.110 | 0.977 | 0.130 |",
    ]


def test_without_motion_there_is_no_table() -> None:
    assert markdown({}) == ""
    assert markdown({"visual": dict.fromkeys(("train", "val", "test"))}) == ""
