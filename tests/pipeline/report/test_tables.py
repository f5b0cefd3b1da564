"""The table of values, the paper's networks and claims, tables, sentences, and DVC's metrics."""

import re

import numpy as np
import pandas as pd
import pytest

from pipeline.evaluate.own_metrics import METRICS, Metric
from pipeline.report import paper, tables, values
from pipeline.scores import motion_scores, pixels
from pipeline.scores.pixels import Scores
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
    for model, settings in preset.merge_preset(name)["models"].items():
        entry = Entry.model_validate(settings)
        if paper.is_network(model, entry.model_dump()):
            published.add(model)
    expected = {model for claim in paper.CLAIMS for model in (claim.model, claim.rival)}
    if name == "kitti":
        expected = {model for model in expected if paper.NETWORKS[model].test_mse}
    assert published >= expected


def test_a_network_with_the_papers_name_and_other_settings_is_not_the_papers():
    assert paper.is_network("sa-gnn-ncp", examples.ENTRY | {"cell": "eq4", "features": 64})
    other = {"temporal": "lstm", "semantics": 0.0, "alpha": 5.0, "equivariant": True, "width": 0.5}
    for key, value in other.items():
        assert not paper.is_network("sa-gnn-ncp", examples.ENTRY | {key: value}), key


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


def test_models_without_common_frames_or_on_straight_roads_have_no_difference(tmp_path):
    table = examples.predictions()
    for model, drive in zip(("scene", "blind"), examples.DRIVES, strict=True):
        examples.write_model(tmp_path, metrics(model), table[table["drive"] == drive])
    _, apart = examples.load(tmp_path, "scene", "blind")
    assert tables.differences_table(apart, "angle-0").table.empty
    assert tables.write_sentences(apart) == []
    assert tables.write_sentences(compare(tmp_path, metrics("straight", None))) == []
    assert tables.write_sentences(compare(tmp_path)) == []


def test_the_first_table_fits_a_terminal(tmp_path):
    """One seed of a network failed to train."""
    content = metrics("pointnet2-lstm", baselines={"odometry": 0.04}, horizon=10)
    content |= {"seeds": [0, 1], "untrained": [1], "parameters": 1_408_259}
    seeds = [examples.predictions(nmse).assign(seed=seed) for seed, nmse in enumerate((0.2, 0.3))]
    examples.write_model(tmp_path, content, pd.concat(seeds))
    examples.write_model(tmp_path, metrics("other", 0.96, horizon=10))
    _, all_values = examples.load(tmp_path, "pointnet2-lstm", "other")
    section = tables.results_table(all_values, "angle-10")
    assert tables.nmse_tables(all_values, "angle-10") == []
    assert max(map(len, section.markdown().splitlines())) <= 110
    assert section.table.index[:2].tolist() == ["pointnet2-lstm ✓ †", "other"]
    assert "† 1 of 2 seeds of pointnet2-lstm failed to train." in section.note
    row = section.table.loc["pointnet2-lstm ✓ †"]
    assert row["nmse"] == "0.250 ± 0.071 (0.175 to 0.325)"
    assert row[["parameters", "edges"]].tolist() == ["1,408,259", "5,160"]
    page = tables.results_table(all_values, "angle-10", page=True).table
    assert page.loc["`pointnet2-lstm` ✓ †", "nmse"] == "0.250\n0.175 to 0.325"


def test_the_papers_claims_have_verdicts(tmp_path):
    """Claims need both networks as in the paper, and comparable ones are not better."""
    lidar = {"input": "lidar", "semantics": 0.0}
    sets = lidar | {"input": "lidar-pointnet2", "spatial": "pointnet2", "window": 6, "width": 0.25}
    models = [
        metrics("sa-gnn-ncp"),
        metrics("lambda-0", semantics=0.0),
        metrics("gnn-ncp", 0.1, **lidar),
        metrics("keep-100", 0.1, input="depth"),
        metrics("gnn-lstm", 0.2, **lidar | {"input": "lidar-50k", "temporal": "lstm"}),
        metrics("pointnet2-ncp", 0.4, **sets),
        metrics("do-gnn-ncp", **lidar),
    ]
    table = compare(tmp_path, *(model | {"seeds": [0, 1]} for model in models))
    claims = tables.claims_table(table, "angle-0").table
    assert claims[["networks", "here", "verdict"]].to_numpy().tolist() == [
        ["gnn-ncp, pointnet2-ncp", "0.25", "confirmed"],
        ["sa-gnn-ncp, lambda-0", "1.00", "no difference shown"],
        ["sa-gnn-ncp, keep-100", "2.00", "reversed"],
        ["gnn-ncp, gnn-lstm", "0.50", "reversed"],
    ]
    assert claims["MSE ratio: paper"].iloc[0] == "0.55"
    errors = tables.results_table(table, "angle-0").table["paper: test MSE"]
    assert errors["gnn-ncp ✓"] == "0.132"
    assert errors["keep-100"] == tables.NONE

    no_claim = compare(tmp_path, metrics("sa-gnn-ncp"), metrics("mine", spatial="pyg"))
    assert "paper: test MSE" not in tables.results_table(no_claim, "angle-0").table


def test_the_best_model_is_compared_with_the_best_baseline_and_the_other_models(tmp_path):
    path = {"predict": "path", "baselines": {"odometry": 0.4}}
    blind = metrics("path-blind", 0.5, predict="path", spatial="blind")
    table = compare(tmp_path, blind, metrics("path", 0.2, **path))
    # Ends of arcs of 5 m, of the true curvature and of those of the three methods.
    curvature = 0.01 * np.delete(np.arange(7, 30), 13) * (1 + np.sqrt([[0], [0.2], [0.5], [0.4]]))
    ends_m = 1j * (1 - np.exp(5j * curvature)) / curvature
    error_m = dict(
        zip(("path", "blind", "odometry"), abs(ends_m[1:] - ends_m[0]).mean(axis=1), strict=True)
    )
    difference = f"{error_m['path'] - error_m['blind']:+.2f}".replace("-", "−")

    differences = tables.differences_table(table, "path-0").table
    assert differences.index.tolist() == ["path − *odometry*", "path − path-blind"]
    cell = differences["at 5 m, m"].iloc[1]
    assert cell.startswith(difference)
    assert cell.endswith("too few seeds")
    assert differences["at 10 m, m"].iloc[1].endswith(")")  # only one error has a verdict
    section = tables.results_table(table, "path-0")
    assert section.table.loc["path ✓", "error at 5 m, m"].startswith(f"{error_m['path']:.2f} (")
    assert section.table.loc["*odometry*", "error at 5 m, m"] == f"{error_m['odometry']:.2f}"
    assert f"{examples.DRIVES[0]} has 50 % of the error at 5 m of path." in section.note
    assert section.note.endswith("at 5 m 44, at 10 m 44.")

    by_range, in_nmse = tables.nmse_tables(table, "path-0")
    assert by_range.table.loc["path", "nmse 0-5 m"] == "0.200 (0.200 to 0.200)"
    assert by_range.table.loc["*odometry*", "nmse 5-10 m"] == "0.400"
    assert in_nmse.table["5-10 m"].iloc[1] == "−0.300 (−0.300 to −0.300)"
    headline, line, compared = tables.write_sentences(table)
    errors = f"{error_m['path']:.2f} m, without the scene {error_m['blind']:.1f} m"
    assert headline == f"No difference shown: the path ahead (at 5 m) is off by {errors}."
    assert "of network `path`, which sees the scene, minus that of `path-blind`" in line
    assert f"is {difference} m, 95 % interval" in line
    assert "One seed is too few for a verdict" in line
    assert compared.startswith("Path ahead: no difference is shown between network `path` (with")
    assert "the least test error, since there is no validation) and *odometry*" in compared


def test_published_values_without_ends_show_their_nmse(tmp_path):
    """Those of before 2026-11-29 have a verdict in each row."""
    blind = metrics("path-blind", 0.5, predict="path", spatial="blind")
    table = compare(tmp_path, blind, metrics("path", 0.2, predict="path"))
    rows = values.to_json(table)
    old = {}
    for key, row in rows.items():
        row.pop("lead", None)
        row.pop("ends", None)
        if "/at " not in key:
            old[key] = row | ({"verdict": "better"} if " - " in key else {})
    table = values.from_json(old)
    assert values.rank_models(table.loc["path-0"]) == ["path", "path-blind"]
    results = tables.results_table(table, "path-0").table
    assert results.loc["path ✓", "nmse 0-5 m"] == "0.200 (0.200 to 0.200)"
    assert tables.nmse_tables(table, "path-0") == []
    headline, line, *_ = tables.write_sentences(table)
    assert headline == "The scene helps: the nmse of the path ahead is 0.20 instead of 0.50."
    assert "is −0.300, 95 % interval −0.300 to −0.300. It is the mean over 2 test drives" in line
    assert line.endswith("the mean over the ranges 0-5 m, 5-10 m.")


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
        assert len(tables.few_drives(rows)) == doubts
        table = rows.loc[f"{predict}-0"]
        assert values.rank_models(table)[0] == "net"
        assert values.best_baseline(table) == rival
        driven_rad = 0.01 * metres * np.delete(np.arange(7, 30), 13).mean()
        mae_deg = np.rad2deg(driven_rad * np.sqrt(nmse).mean())
        assert table.loc[("", "net"), "mae"] == pytest.approx(mae_deg)
        return values.read_difference(table, "net", rival)["verdict"]

    assert verdict_of([0]) == "too few seeds"
    assert verdict_of([0, 1]) == verdict
    blocks = examples.SETTINGS.model_copy(update={"bootstrap_block_frames": 6})
    monkeypatch.setattr(examples, "SETTINGS", blocks)
    for seeds in ([0], [0, 1]):
        assert verdict_of(seeds, doubts=1) == "too few drives"


@pytest.mark.parametrize("with_blind", [True, False])
@pytest.mark.parametrize("verdict", ["better", "worse", "no difference shown", "too few drives"])
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_headline_has_the_verdict_and_both_errors_in_20_words(
    tmp_path, predict, verdict, with_blind
):
    """Errors of 0.004 and 0.006 differ in the digit that tables would round away."""
    baselines = {"regression": 0.006 if verdict != "worse" else 0.002}
    models = [metrics("path", 0.004, baselines, predict=predict)]
    rival = "regression"
    if with_blind:
        rival = "path-blind"
        models.append(metrics(rival, 0.006, baselines, predict=predict, spatial="blind"))
    validation = {"nmse": 0.1, "error": 0.1}
    for content, factor in zip(models, (1, 2), strict=False):
        error = {key: factor * value for key, value in validation.items()}
        content["val"] = {content["model"]: error, f"at 5 m/{content['model']}": error}
    table = compare(tmp_path, *(model | {"seeds": [0, 1]} for model in models))
    lead = values.lead_label(table.loc[f"{predict}-0"])
    table.loc[(f"{predict}-0", lead, f"path - {rival}"), ["verdict", "parts"]] = [verdict, 4]
    headline, line, *_ = tables.write_sentences(table)
    assert len(headline.split()) <= 20
    start = {
        ("better", True): "The scene helps: ",
        ("worse", True): "Worse with the scene: ",
        ("better", False): "`path` is better than *regression*: ",
        ("worse", False): "*regression* is better than `path`: ",
    }.get((verdict, with_blind), "No difference shown: ")
    assert headline.startswith(start)
    first, second = re.findall(r"\d\.\d+", headline)
    assert first != second
    reason = "A verdict needs 10 test drives or parts of long ones, and there are 4."
    assert (reason in line) == (verdict == "too few drives")


@pytest.mark.parametrize(
    ("scene", "blind", "start"),
    [
        ([0.2, 0.2], 0.1, "Worse with the scene: {} 0.20 instead of "),
        ([0.1, 0.3], 0.15, "No difference shown: {} 0.20, without "),
        ([0.1, 0.1], 0.2, "The scene helps: {} 0.10 instead of 0.20."),
    ],
)
def test_the_scene_is_judged_if_the_best_network_does_not_see_it(tmp_path, scene, blind, start):
    """Networks are ranked by validation, and compared on the test drives."""
    models = []
    for name, nmse, spatial, error in (
        ("net", scene, "gnn", 0.2),
        ("net-blind", blind, "blind", 0.1),
    ):
        content = metrics(name, nmse, spatial=spatial) | {"seeds": [0, 1]}
        models.append(content | {"val": {name: {"nmse": error}}})
    table = compare(tmp_path, *models)
    assert values.rank_models(table.loc["angle-0"]) == ["net-blind", "net"]
    headline, line, compared = tables.write_sentences(table)
    assert headline.startswith(start.format("the nmse of the steering angle is"))
    assert "of network `net`, which sees the scene, minus that of `net-blind`" in line
    assert "network `net-blind` (with the least validation error)" in compared


def test_errors_get_digits_until_they_differ(tmp_path):
    """Ten frames ahead, whose number is between commas."""
    baselines = {"regression": 0.3104}
    for nmse, texts in ((0.3101, "0.3101 with `net`, 0.3104"), (0.3104, "0.310 with `net`, 0.310")):
        rows = compare(tmp_path, metrics("net", nmse, baselines, horizon=10))
        headline, *_ = tables.write_sentences(rows)
        subject = "the nmse of the steering angle, 10 frames ahead, is"
        assert headline == f"No difference shown: {subject} {texts} with *regression*."


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
    headline, *_ = tables.write_sentences(rows)
    assert "the path ahead (final) is off by" in headline


def test_one_test_drive_has_no_interval(tmp_path, monkeypatch):
    """A drive that is longer than a block would be cut into parts."""
    whole_drives = examples.SETTINGS.model_copy(update={"bootstrap_block_frames": 200})
    monkeypatch.setattr(examples, "SETTINGS", whole_drives)
    baselines = {"odometry": 0.003}
    table = examples.predictions(0.08, baselines=baselines)
    table = table[table["drive"] == examples.DRIVES[0]]
    examples.write_model(tmp_path, metrics("net", 0.08) | {"seeds": [0, 1]}, table)
    _, one_drive = examples.load(tmp_path, "net")
    _, line = tables.write_sentences(one_drive)
    assert "is +0.077 (one test drive: no interval). A verdict needs" in line
    assert "needs 10 test drives or parts of long ones, and there is one." in line
    cell = tables.results_table(one_drive, "angle-0", page=True).table.loc["`net` ✓", "nmse"]
    assert cell == "0.080\none test drive: no interval"


def test_a_sentence_says_that_odometry_measures_the_present_angle_better(tmp_path):
    baselines = {"odometry": 0.003}
    net = metrics("net", 0.08, baselines) | {"seeds": [0, 1]}
    blind = metrics("blind", 0.5, baselines, spatial="blind") | {"seeds": [0, 1]}
    *_, line = tables.write_sentences(compare(tmp_path, net, blind))
    assert line.startswith("Steering angle: *odometry* (what the images show")
    assert "measures it better than network `net`" in line
    assert "by the nmse: 0.003 instead of 0.080. The difference, `net` minus *odometry*" in line


def test_a_text_gets_the_definitions_of_its_words_only():
    text = "the nmse of *zero*, and its edges; coverages, knowledges"
    assert [*tables.define_words(text)] == ["nmse", "edges", "zero"]


def test_few_turning_frames_are_doubted(tmp_path):
    (doubt,) = tables.few_turns(compare(tmp_path, metrics("net") | {"turning_frames": 19}))
    assert doubt.startswith("19 frames of the training drives turn")
    assert tables.few_turns(compare(tmp_path, metrics("net") | {"turning_frames": 20})) == []


def test_scores_have_a_table_per_part_and_a_row_per_split():
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["test"].add_depth("depth_lidar", truth, truth)
    scores["test"].add_classes(np.array([3, 4]), np.array([3, 3]))
    report = {split: score.to_report() for split, score in scores.items()}
    motion = {"drives": 20, "nmse": None, "speed_ratio": 0.99457, "yaw_rmse_degps": 0.27210444}
    report["motion"] = {"train": None, "val": None, "test": motion}
    sections = tables.scores_tables(report)
    titles = ["Depth, compared with LiDAR", "Classes, compared with dense truth"]
    titles.append("Motion by visual odometry, compared with recorded motion")
    assert [section.title for section in sections] == titles
    rows = [section.table.reset_index().to_dict("records") for section in sections]
    within = {"frames": "1", "error / depth": "0.2", "RMSE, m": "2", "within 25 %": "1"}
    exact = within | {"error / depth": "0", "RMSE, m": "0"}
    speed = {"speed: measured / recorded": "0.995", "yaw rate: RMSE, deg/s": "0.272"}
    assert rows == [
        [
            {"split": "val"} | within | {"coverage": "1"},
            {"split": "test"} | exact | {"coverage": "1"},
        ],
        [{"split": "test", "frames": "1", "mean IoU": "0.5", "pixel accuracy": "0.5"}],
        [{"split": "test", "drives": "20"} | speed],
    ]


def test_names_of_the_code_have_words_in_tables_of_scores():
    motion = motion_scores.summarise_errors([motion_scores.MotionErrors(*np.ones((5, 3)))])
    report = Scores().to_report()
    assert report.keys() | {"motion"} == tables.SCORES.keys()
    for head in tables.SCORE_HEADS.values():
        assert "_" not in head
    numbers = {key for key in motion if "_" in key} | {*pixels.DEPTH_ERRORS}
    assert numbers <= tables.SCORE_HEADS.keys()
