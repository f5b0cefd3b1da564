from typing import Any

from pipeline.report.tables import comparison, steering_table
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


def older() -> dict[str, Any]:
    """A model that an older version judged."""
    made = result("old")
    del made["line"]["cell"], made["line"]["equivariant"], made["test"]["by_drive"], made["test"]["without_decisions"]
    return made


def test_older_results_lack_settings_and_figures() -> None:
    row = cells(steering_table.markdown([older()]), "old")
    assert (row["temporal"], row["equivariant"], row["semantics"]) == ("ncp", "no", "0")
    assert (row["motion"], row["horizon"], row["fitted to"]) == ("none", "0", "train")
    assert (row["nmse 0002"], row["nmse without decisions"]) == ("none", "none")


def test_each_test_drive_has_a_column_by_its_number() -> None:
    made = result("ours", odometry={"odometry": 0.04})
    row = cells(steering_table.markdown([made]), "ours")
    assert (row["nmse 0002"], row["nmse 0003"], row["nmse without decisions"]) == ("0.190", "0.180", "0.100")
    odometry = cells(steering_table.markdown([made]), "*odometry*")
    assert (odometry["nmse 0002"], odometry["nmse without decisions"]) == ("0.040", "0.020")
    made["drives"]["test"] = ["2026_01_03_drive_0002", "2026_01_04_drive_0002"]
    assert "nmse 2026_01_04_drive_0002" in steering_table.markdown([made])
    for few_or_many in (1, 7):
        made["drives"]["test"] = [f"2026_01_03_drive_{number:04d}" for number in range(few_or_many)]
        assert "nmse 0000" not in steering_table.markdown([made])


def test_trivial_predictors_stand_below_the_models_of_their_horizon() -> None:
    ahead = {"horizon": 10, "motion": "visual", "fit_to": "both", "roads": 6}
    results = [
        result("far", odometry={"odometry": 0.5}, **ahead),
        result("near", **PAPERS),
        result("near too", odometry={"odometry": 0.04, "odometry_lidar": 0.03}, motion="lidar"),
    ]
    text = steering_table.markdown(comparison.in_order(results))
    first = [line.split("|")[1].strip() for line in text.split("\n\n")[0].splitlines()[2:]]
    simple = ["*zero*", "*train_mean*", "*persistence*", "*odometry*"]
    assert first == ["near", "near too", *simple, "*odometry_lidar*", "far", *simple]
    row = cells(text, "far")
    assert (row["horizon"], row["motion"], row["fitted to"]) == ("10", "visual", "both (6 roads)")
    assert "| test RMSE deg, 10 frames ahead, where the road" in text


def test_what_was_measured_on_some_drives_alone_has_no_figure_for_all() -> None:
    made = result("ours", odometry={"odometry": 0.04})
    made["test"]["baselines"]["odometry"] = dict.fromkeys(("mse_rad2", "rmse_deg", "mae_deg", "nmse")) | {"frames": 0}
    row = cells(steering_table.markdown([made]), "*odometry*")
    assert [row[key] for key in ("test nmse", "MAE deg", "nmse 0002")] == ["none", "none", "0.040"]
    assert row["MSE rad² train / val / test"] == "0.00040 / none / none"


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
