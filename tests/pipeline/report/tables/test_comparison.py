from pipeline.report.tables import comparison
from tests.pipeline.report.tables.results import result

PAPERS = {"input": "depth", "semantics": 0.0}


def test_the_papers_networks_come_first_in_its_order() -> None:
    results = [
        result("b", spatial="gatv2"),
        result("sa", semantics=1.0),
        result("a", spatial="edgeconv"),
        result("do", **PAPERS),
        result("lstm", input="lidar-50k", temporal="lstm", cell=None),
    ]
    assert [made["model"] for made in comparison.in_order(results)] == ["lstm", "do", "sa", "b", "a"]


def test_models_that_look_ahead_come_behind() -> None:
    results = [result("far", **PAPERS, horizon=10), result("ours", spatial="gatv2"), result("do", **PAPERS)]
    ordered = comparison.in_order(results)
    assert [made["model"] for made in ordered] == ["do", "ours", "far"]
    assert [[made["model"] for made in group] for group in comparison.by_horizon(ordered)] == [["do", "ours"], ["far"]]


def test_a_network_on_accumulated_clouds_is_not_the_papers() -> None:
    plain = result("do", **PAPERS) | {"variant": {"accumulate": None}}
    assert comparison.published(plain)
    assert comparison.published(plain | {"variant": {"accumulate": {"motion": "visual", "frames": 8}}}) is None


def test_a_predictor_that_some_splits_lack_has_none_there() -> None:
    made = result("ours", odometry={"odometry": 0.04})
    del made["train"]["baselines"]["odometry"]
    of_split = comparison.baselines([result("without"), made])["odometry"]
    assert (of_split["train"], of_split["val"], of_split["test"]["nmse"]) == (None, None, 0.04)
