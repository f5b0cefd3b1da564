import csv
import io

from pipeline.report.tables import steering_table
from tests.pipeline.report.tables.results import result

PAPERS = {"input": "depth", "semantics": 0.0}


def cells(text: str, model: str) -> dict[str, str]:
    """Return column → cell of a model's row in the first table."""
    head, _, *body = (line for line in text.split("\n\n")[0].splitlines())
    row = next(line for line in body if line.startswith(f"| {model} |"))
    return dict(zip(*([cell.strip() for cell in line.split("|")[1:-1]] for line in (head, row)), strict=True))


def test_a_row_says_what_was_trained() -> None:
    text = steering_table.markdown([result("ours", semantics=1.0, equivariant=True)])
    row = cells(text, "ours")
    assert {key: row[key] for key in ("input", "points", "semantics", "spatial", "temporal", "equivariant")} == {
        "input": "semantic", "points": "1,000", "semantics": "1", "spatial": "gnn", "temporal": "ncp (ltc)",
        "equivariant": "yes",
    }  # fmt: skip
    assert (row["window"], row["test nmse"], row["95 % interval"]) == ("8", "0.200", "0.100 to 0.300")
    assert row["MSE rad² train / val / test"] == "0.00100 / none / 0.00200"
    assert row["edges (unpruned)"] == "5,160 (6,000, −14%)"
    assert "ms" not in text.split()


def test_the_papers_figures_stand_beside_its_own_networks_alone() -> None:
    results = [result("mine", **PAPERS), result("do-gnn-ncp", **PAPERS, equivariant=True)]
    text = steering_table.markdown(results)
    assert cells(text, "mine")["paper"] == "0.038 / 0.081"
    assert cells(text, "do-gnn-ncp")["paper"] == ""
    assert [row.get("paper_test_mse") for row in steering_table.rows(results)][:2] == [0.081, None]


def test_the_papers_networks_come_first_in_its_order() -> None:
    results = [
        result("b", spatial="gatv2"),
        result("sa", semantics=1.0),
        result("a", spatial="edgeconv"),
        result("do", **PAPERS),
        result("lstm", input="lidar-50k", temporal="lstm", cell=None),
    ]
    assert [made["model"] for made in steering_table.in_order(results)] == ["lstm", "do", "sa", "b", "a"]


def test_rows_hold_the_settings_and_no_clock() -> None:
    table = io.StringIO()
    rows = steering_table.rows([result("ours", temporal="lstm", semantics=0.5)])
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    ours, zero, *_ = csv.DictReader(io.StringIO(table.getvalue()))
    assert (ours["temporal"], ours["cell"], ours["equivariant"], ours["semantics"]) == ("lstm", "", "False", "0.5")
    assert (zero["model"], zero["test_nmse"], zero["spatial"]) == ("zero", "1.0", "")
    assert not any("ms" in name.split("_") for name in ours)


def test_older_results_lack_settings() -> None:
    old = result("old")
    del old["line"]["cell"], old["line"]["equivariant"]
    row = cells(steering_table.markdown([old]), "old")
    assert (row["temporal"], row["equivariant"], row["semantics"]) == ("ncp", "no", "0")


def test_seeds_are_told_by_their_spread() -> None:
    one, two = result("one"), result("two")
    two["seeds"] = [0, 1]
    two["test"]["nmse_std"] = 0.03
    assert "One seed each" in steering_table.markdown([one])
    text = steering_table.markdown([one, two])
    assert "Means over 1 to 2 seeds" in text
    assert cells(text, "two")["test nmse"] == "0.200 ± 0.030"


def test_errors_stand_by_curvature() -> None:
    lines = steering_table.markdown([result("ours")]).splitlines()
    assert "| ours | 2.56 | none |" in lines
    assert "| *zero* | 5.73 | none |" in lines


def test_what_has_no_graph_says_none() -> None:
    images = result("cnn", spatial="cnn", input="image")
    images |= {"points_per_frame": None, "edges_per_frame": None, "edges_per_frame_unpruned": None}
    row = cells(steering_table.markdown([images]), "cnn")
    assert (row["points"], row["edges (unpruned)"]) == ("none", "none")


def test_one_command_gets_a_model_that_is_not_here() -> None:
    text = steering_table.markdown([], absent=["other"])
    assert "dvc repro --pull --downstream train@other" in text
    assert steering_table.rows([]) == []
