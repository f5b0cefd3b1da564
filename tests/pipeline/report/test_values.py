"""The table of values, the paper's networks, and DVC's metrics."""

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.evaluate.own_metrics import METRICS, Metric
from pipeline.report import paper, sentences, tables, values
from pipeline.train.entry import Entry
from pipeline.train.quantities import path
from pipeline.train.quantities.path import Target
from stages import preset
from tests.pipeline.report import examples
from tests.pipeline.report.examples import compare, metrics


def test_tasks_and_rows_are_sorted_with_baselines_last(tmp_path):
    table = compare(
        tmp_path,
        metrics("path", predict="path"),
        metrics("far", baselines={"odometry": 0.5}, horizon=10),
        metrics("ours", spatial="pyg", baselines={"odometry": 0.04}),
        metrics("do-gnn-ncp", baselines={"persistence": 0.01}, input="depth", semantics=0.0),
        metrics("gnn-lstm", input="lidar-50k", temporal="lstm", semantics=0.0),
    )
    titles = [values.title_of(task) for task in table.index.unique("task")]
    assert titles == ["path ahead", "steering angle", "steering angle, 10 frames ahead"]
    angle = table.loc["angle-0"]
    assert values.list_methods(angle) == [
        *["gnn-lstm", "do-gnn-ncp", "ours"],
        *["zero", "train_mean", "odometry", "persistence"],
    ]
    assert values.list_ranges(table.loc["path-0"]) == ["0-5 m", "5-10 m"]
    assert values.list_ends(table.loc["path-0"]) == ["at 5 m", "at 10 m"]
    assert values.list_ranges(angle) == [""]
    assert values.list_ends(angle) == []


@pytest.mark.parametrize("name", ["kitti", "table2"])
def test_networks_of_the_presets_are_the_papers(name):
    published = set()
    params = preset.merge_preset(name)
    for model, settings in params["models"].items():
        entry = Entry.model_validate(settings)
        if paper.is_network(model, entry.model_dump(), params["graphs"][entry.input]):
            published.add(model)
    expected = {model for claim in paper.CLAIMS for model in (claim.model, claim.rival)}
    if name == "kitti":
        expected = {model for model in expected if paper.NETWORKS[model].test_mse}
    assert published >= expected


def test_a_network_with_the_papers_name_and_other_settings_is_not_the_papers():
    variant = examples.VARIANTS["semantic"]
    network = examples.ENTRY | {"cell": "eq4", "features": 64}
    assert paper.is_network("sa-gnn-ncp", network, variant)
    other = {"temporal": "lstm", "semantics": 0.0, "alpha": 5.0, "equivariant": True, "width": 0.5}
    for key, value in other.items():
        assert not paper.is_network("sa-gnn-ncp", examples.ENTRY | {key: value}, variant), key


@pytest.mark.parametrize(
    ("name", "changes", "is_papers"),
    [
        ("sa-gnn-ncp", {"points": 50, "crop_m": [-15, -10, 15, 30]}, True),
        ("sa-gnn-ncp", {"keep_inter_class": 1.0}, False),
        ("sa-gnn-ncp", {"k": 0}, False),
        ("sa-gnn-ncp", {"source": "clouds/lidar"}, False),
        ("keep-100", {"keep_inter_class": 1.0}, True),
        ("keep-100", {"keep_inter_class": 0.2}, False),
        ("gnn-ncp", {"source": "clouds/pseudo"}, False),
        ("pointnet2-ncp", {"k": 6}, True),
    ],
)
def test_a_network_with_another_input_under_the_papers_name_is_not_the_papers(
    name, changes, is_papers
):
    """The claims need the source of the points, edges, and pruning or none."""
    network = paper.NETWORKS[name]
    entry = examples.ENTRY | network._asdict() | {"width": 1.0}
    variant = examples.VARIANTS[network.input] | changes
    assert paper.is_network(name, entry, variant) == is_papers


def test_values_have_errors_differences_and_validation_and_are_read_again(tmp_path):
    validation = {"path": {"nmse": 0.9}, "at 5 m/path": {"error": 0.123456}}
    scene = metrics("path", [0.2, 0.4], predict="path") | {"val": validation}
    blind = metrics("path-blind", 0.9, predict="path", spatial="blind")
    table = compare(tmp_path, scene, blind)
    rows = values.to_json(table)
    far = {"nmse": 0.3, "unit": "deg", "frames": 44, "drives": 2, "seeds": [0.3]}
    assert far.items() <= rows["path-0/5-10 m/path"].items()
    assert rows["path-0/5-10 m/path - path-blind"]["nmse"] == -0.6
    mean = {"lead": "at 5 m", "validation": 0.12346, "parameters": 9259, "edges": 5160.0}
    assert mean.items() <= rows["path-0/path"].items()
    end = {"unit": "m", "frames": 44, "drives": 2, "worst_drive": examples.DRIVES[1]}
    assert end.items() <= rows["path-0/at 5 m/path"].items()
    assert "verdict" in rows["path-0/at 5 m/path - path-blind"]
    assert "verdict" not in rows["path-0/path - path-blind"]
    shown = values.dvc_metrics(table)
    errors = {name: rows[f"path-0/at 5 m/{name}"]["error"] for name in ("path", "path-blind")}
    assert shown == {"error": pytest.approx(errors)}
    assert values.to_json(values.from_json(rows)) == rows


@pytest.mark.parametrize(
    ("spatial", "facts", "sees"),
    [
        ("gnn", {"sees_frames": True}, True),
        ("gnn", {}, True),
        ("blind", {"sees_frames": False}, False),
        ("blind", {}, False),
        ("mine", {"sees_frames": False}, False),
    ],
)
def test_a_network_that_does_not_see_its_frames_has_no_scene(tmp_path, spatial, facts, sees):
    """Files of earlier revisions have no key sees_frames: there, the name tells."""
    examples.write_model(tmp_path, metrics("net", spatial=spatial) | facts)
    tasks, table = examples.load(tmp_path, "net")
    assert (values.with_scene(table.loc["angle-0"]) == "net") == sees
    assert ("points" in tables.models_table(tasks).table) == sees


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [("wheelbase_m", 3.5, "= 2.5, b with 3.5"), ("source", "motion", "= not set, b with motion")],
)
def test_models_with_labels_of_other_settings_are_not_compared(tmp_path, key, value, text):
    """Tasks of their own have a truth of their own."""
    other = metrics("b") | {"labels": examples.LABELS | {key: value}}
    fix = r"dvc repro evaluate@a evaluate@b"
    with pytest.raises(InputError, match=rf"a was evaluated with labels\.{key} {text}.*{fix}"):
        compare(tmp_path, metrics("a"), other)
    ahead = other | {"entry": other["entry"] | {"horizon": 10}}
    assert len(compare(tmp_path, metrics("a"), ahead).index.unique("task")) == 2


def test_all_rows_are_compared_on_common_frames_with_one_zero(tmp_path):
    """On its own frames the window of 4 is worse, since it also predicts frames 3 to 6.

    Odometry begins at frame 9.
    """
    baselines = {"odometry": 0.5, "regression": 0.5}
    short = examples.predictions(0.3, baselines=baselines)
    long = examples.predictions(0.5, baselines=baselines)
    for table in (short, long):
        table.loc[table["frame"] < 9, "odometry_steering_rad"] = np.nan
    short.loc[short["frame"].between(3, 6), "predicted_steering_rad"] = 1.0
    examples.write_model(tmp_path, metrics("short", 0.9, window=4), short)
    examples.write_model(tmp_path, metrics("long", 0.5, window=8) | {"seeds": [0, 1]}, long)
    _, all_values = examples.load(tmp_path, "long", "short")
    angle = all_values.loc["angle-0"]
    assert values.rank_models(angle) == ["short", "long"]
    nmse = angle.loc[""]["nmse"].astype(float)
    unknown = (7**2 + 8**2) / sum(np.delete(np.arange(7, 30), 13) ** 2)
    expected = {"short": 0.3, "long": 0.5, "zero": 1.0, "odometry": 0.5 * (1 + unknown)}
    assert nmse[[*expected]].tolist() == pytest.approx([*expected.values()])
    assert set(angle.loc[""].loc[values.list_methods(angle), "frames"]) == {2 * 22}
    difference = values.read_difference(angle, "short", "long")
    assert difference[["nmse", "low", "high"]].tolist() == pytest.approx([-0.2] * 3)


@pytest.mark.parametrize(
    ("files", "ranks", "errors"),
    [
        (["short", "long"], ["short", "long"], [0.3, 0.5]),
        (["short"], ["long", "short"], [0.9, 0.5]),
        ([], ["long", "short"], [0.9, 0.5]),
    ],
)
def test_models_are_validated_on_common_frames(tmp_path, files, ranks, errors):
    """On its own frames the window of 4 is worse, since it also predicts frames 3 to 6.

    Without the predictions of all models, which earlier revisions lack, a note says so.
    """
    tables_of = {"short": examples.predictions(0.3), "long": examples.predictions(0.5)}
    is_early = tables_of["short"]["frame"].between(3, 6)
    tables_of["short"].loc[is_early, "predicted_steering_rad"] = 1.0
    for name, error, frames in (("short", 0.9, 52), ("long", 0.5, 44)):
        content = metrics(name) | {"val": {name: {"nmse": error, "frames": frames}}}
        validation = tables_of[name] if name in files else None
        examples.write_model(tmp_path, content, validation=validation)
    _, all_values = examples.load(tmp_path, "short", "long")
    angle = all_values.loc["angle-0"]
    assert values.rank_models(angle) == ranks
    assert angle.loc[""].loc[["short", "long"], "validation"].tolist() == pytest.approx(errors)
    note = tables.results_table(all_values, "angle-0").note
    assert "✓ has the least validation error." in note
    is_own = "Each validation error is over the frames that the model predicts itself." in note
    assert is_own == (len(files) < 2)


@pytest.mark.parametrize(
    ("nmse", "baselines", "rival", "verdict"),
    [
        (0.2, {"train_mean": 2.0}, "zero", "better"),
        (0.2, {"odometry": 0.6, "regression": 0.4, "persistence": 0.01}, "regression", "better"),
        ([0.1, 0.4], {"odometry": 0.3}, "odometry", "no difference shown"),
        (0.6, {"odometry": 0.05}, "odometry", "worse"),
    ],
)
@pytest.mark.parametrize(("predict", "metres"), [("angle", 1), ("path", 10)])
def test_the_best_validated_model_has_a_verdict(
    tmp_path, monkeypatch, nmse, baselines, rival, verdict, predict, metres
):
    """Methods are compared with two seeds.

    The two drives have ten parts that count as drives, or eight.
    """
    other = metrics("other", 0.01, baselines, predict=predict)
    net = metrics("net", nmse, baselines, predict=predict)
    for content, error in ((other, 0.4), (net, 0.3)):
        name = content["model"]
        content["val"] = {name: {"nmse": error}}
        if predict == "path":
            content["val"] = {name: {"nmse": 1 - error}, f"at 5 m/{name}": {"error": error}}

    def verdict_of(seeds: list[int], doubts: int = 0) -> str:
        models = [model | {"seeds": seeds} for model in (other, net)]
        rows = compare(tmp_path, *models)
        assert len(sentences.few_drives(rows)) == doubts
        table = rows.loc[f"{predict}-0"]
        assert values.rank_models(table)[0] == "net"
        assert values.best_baseline(table) == rival
        driven_rad = 0.01 * metres * np.delete(np.arange(7, 30), 13).mean()
        mae_deg = np.rad2deg(driven_rad * np.sqrt(nmse).mean())
        assert table.loc[("", "net"), "mae"] == pytest.approx(mae_deg)
        return values.read_difference(table, "net", rival)["verdict"]

    assert verdict_of([0]) == "too few seeds"
    assert verdict_of([0, 1]) == verdict
    blocks = examples.SETTINGS.model_copy(update={"bootstrap_block_s": 0.6})
    monkeypatch.setattr(examples, "SETTINGS", blocks)
    for seeds in ([0], [0, 1]):
        assert verdict_of(seeds, doubts=1) == "too few drives"


def test_metrics_of_your_own_have_a_row_where_an_end_is_that_of_a_range(tmp_path, monkeypatch):
    """The quantity's other ends are not those of its two ranges."""

    class Final(Target):
        def __init__(self, labels, horizon=0):
            super().__init__(labels, horizon)
            self.ends = ["final"]
            self.lead = "final"

        def errors(self, predicted, truth):
            return super().errors(predicted, truth)[..., -1:]

    share = Metric(lambda truth, predicted, quantity, column: column / 2, units=("1/m",))
    monkeypatch.setitem(METRICS, "share", share)
    rows = compare(tmp_path, metrics("path", predict="path"), metrics("net"))
    assert values.dvc_metrics(rows)["share"] == {"path": 0.0}
    monkeypatch.setattr(path, "Target", Final)
    rows = compare(tmp_path, metrics("path", predict="path"))
    shown = values.dvc_metrics(rows)
    assert shown["error"].keys() == {"path"}
    assert shown["share"] == {}
    headline, *_ = sentences.write_sentences(rows)
    assert "the path ahead (final) is off by" in headline
