import csv
import io

import pytest

from pipeline.report.tables import steering_rows
from tests.pipeline.report.tables.results import result


def test_rows_hold_the_settings_and_no_clock() -> None:
    table = io.StringIO()
    rows = steering_rows.rows([result("ours", temporal="lstm", semantics=0.5)])
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    ours, zero, *_ = csv.DictReader(io.StringIO(table.getvalue()))
    assert (ours["temporal"], ours["cell"], ours["equivariant"], ours["semantics"]) == ("lstm", "", "False", "0.5")
    assert (zero["model"], zero["test_nmse"], zero["spatial"]) == ("zero", "1.0", "")
    assert not any("ms" in name.split("_") for name in ours)


def test_the_papers_figures_stand_beside_its_own_networks_alone() -> None:
    papers = {"input": "depth", "semantics": 0.0}
    made = steering_rows.rows([result("mine", **papers), result("do-gnn-ncp", **papers, equivariant=True)])
    assert [row.get("paper_test_mse") for row in made][:2] == [0.081, None]
    assert steering_rows.rows([]) == []


def test_a_row_tells_horizon_drives_and_what_can_be_known() -> None:
    ours, *_, odometry = steering_rows.rows([result("ours", odometry={"odometry": 0.04}, horizon=10, motion="visual")])
    assert (ours["motion"], ours["horizon"], ours["fit_to"], ours["roads"]) == ("visual", 10, None, None)
    assert (odometry["model"], odometry["horizon"]) == ("odometry", 10)
    columns = ("test_nmse", "test_nmse 2026_01_03_drive_0003", "test_without_decisions_nmse")
    assert [ours[column] for column in columns] == pytest.approx([0.2, 0.18, 0.1])
    assert [odometry[column] for column in columns] == pytest.approx([0.04, 0.04, 0.02])
    assert ours["test_without_decisions_frames"] == 30
