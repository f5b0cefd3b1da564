"""Groups, the paper's networks and claims, tables, sentences, and DVC's metrics."""

import numpy as np
import pandas as pd
import pytest

from pipeline.report import paper, summary, tables
from pipeline.scores.pixels import Scores
from pipeline.train.entry import Entry
from stages import preset
from tests.pipeline.report import examples
from tests.pipeline.report.examples import compare, metrics


def test_groups_and_rows_are_sorted_with_baselines_last(tmp_path):
    path, angle, far = compare(
        tmp_path,
        metrics("path", predict="path"),
        metrics("far", baselines={"odometry": 0.5}, horizon=10),
        metrics("ours", spatial="pyg", baselines={"odometry": 0.04}),
        metrics("do-gnn-ncp", baselines={"persistence": 0.01}, input="depth", semantics=0.0),
        metrics("gnn-lstm", input="lidar-50k", temporal="lstm", semantics=0.0),
    )
    assert angle.title == "steering angle"
    assert far.title == "steering angle, 10 frames ahead"
    assert path.title == "path ahead"
    assert angle.models == ["gnn-lstm", "do-gnn-ncp", "ours"]
    assert angle.baselines == ["zero", "train_mean", "odometry", "persistence"]
    assert angle.entry("odometry")["value"] == pytest.approx(0.04)
    assert angle.best_baseline == "odometry"
    assert path.labels == ["0-5 m", "5-10 m"]


@pytest.mark.parametrize("name", ["kitti", "table2"])
def test_networks_of_the_presets_are_the_papers(name):
    published = set()
    for model, settings in preset.merged(name)["models"].items():
        entry = Entry.model_validate(settings)
        if paper.find(model, entry.model_dump(), {}):
            published.add(model)
    assert published == paper.PAPER.keys()


def test_a_network_with_the_papers_name_and_other_settings_is_not_the_papers():
    def find(variant: dict[str, int], **change: object) -> paper.Published | None:
        return paper.find("sa-gnn-ncp", examples.ENTRY | change, variant)

    assert find({}, cell="eq4", features=64) == paper.PAPER["sa-gnn-ncp"]
    assert find({}, temporal="lstm") is None
    assert find({}, semantics=0.0) is None
    assert find({}, alpha=5.0) is None
    assert find({}, equivariant=True) is None
    assert find({}, scene="another") is None
    assert find({}, width=0.5) is None
    assert find({"accumulate": 8}) is None


def test_angles_in_degrees_are_those_of_the_wheels_or_the_turns_of_a_path(tmp_path):
    path, angle = examples.groups(
        tmp_path, metrics("net", 0.25), metrics("path", 0.25, predict="path")
    )
    for group, name, factor in ((angle, "net", 1), (path, "path", 10)):  # curvature times metres
        row = group.first_seed(name).iloc[10]
        expected_rad = [0.1 * factor, 0.15 * factor]
        assert row[["shown_true", "shown_predicted"]].tolist() == pytest.approx(
            np.rad2deg(expected_rad)
        )


def test_errors_differences_and_validation_errors(tmp_path):
    scene = metrics("path", [0.2, 0.4], predict="path") | {"drives": {"train": ["a"] * 3}}
    nmse = zip(scene["test"], (0.1, 0.3), strict=True)
    scene["val"] = {column: {"nmse": value, "nmse_by_seed": [value]} for column, value in nmse}
    scene["val"]["a straight range"] = {"nmse": None, "nmse_by_seed": [None]}
    blind = metrics("path-blind", 0.9, predict="path")
    (comparison,) = compare(tmp_path, scene, blind)
    values = summary.rounded(comparison.values)
    assert {"value": 0.3, "frames": 44, "seeds": [0.3]}.items() <= values[
        "path-0/5-10 m/path"
    ].items()
    assert values["path-0/5-10 m/path - path-blind"]["value"] == -0.6
    assert {"value": 0.2, "seeds": [0.2], "roads": 3}.items() <= values["val/path"].items()
    assert summary.dvc_metrics(values)["path-0/5-10 m/path"]["nmse"] == 0.3


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
    (comparison,) = examples.load(tmp_path, "long", "short")
    assert comparison.by_error == ["short", "long"]
    assert comparison.entry("short")["value"] == pytest.approx(0.3)
    assert comparison.entry("long")["value"] == pytest.approx(0.5)
    assert comparison.entry("zero")["value"] == pytest.approx(1.0)
    for name in (*comparison.models, *comparison.baselines):
        assert comparison.entry(name)["frames"] == 2 * 22
    difference = comparison.difference("short", "long")
    assert difference["value"] == pytest.approx(-0.2)
    assert difference["interval"] == pytest.approx([-0.2, -0.2])
    unknown = (7**2 + 8**2) / sum(np.delete(np.arange(7, 30), 13) ** 2)
    assert comparison.entry("odometry")["value"] == pytest.approx(0.5 * (1 + unknown))
    choice = "short is the model with the least test error (there is no validation): "
    assert choice in tables.sentences([comparison])[1]


def test_models_without_common_frames_or_on_straight_roads_have_no_difference(tmp_path):
    table = examples.predictions()
    for model, drive in zip(("scene", "blind"), examples.DRIVES, strict=True):
        examples.write_model(tmp_path, metrics(model), table[table["drive"] == drive])
    comparisons = examples.load(tmp_path, "scene", "blind")
    differences = tables.differences_table(comparisons[0])
    assert {row["nmse"] for row in differences.rows} == {tables.NONE}
    straight = compare(tmp_path, metrics("straight", None))
    assert tables.sentences(comparisons) == []
    assert tables.sentences(straight) == []
    assert tables.sentences([]) == []


def test_the_first_table_fits_a_terminal(tmp_path):
    seeds = {"seeds": [0, 1], "untrained": [1], "parameters": 1_408_259}
    content = metrics("pointnet2-lstm", baselines={"odometry": 0.04}, horizon=10) | seeds
    first = examples.predictions(0.2, baselines={"odometry": 0.04})
    second = examples.predictions(0.3)
    right = second["frame"].between(10, 15)
    second.loc[right, "predicted_steering_rad"] = second["true_steering_rad"]
    both = pd.concat([first.assign(seed=0), second.assign(seed=1)])
    examples.write_model(tmp_path, content, both)
    examples.write_model(tmp_path, metrics("dead", 0.96, horizon=10))
    (comparison,) = examples.load(tmp_path, "pointnet2-lstm", "dead")
    table = tables.results_table(comparison)
    assert max(map(len, table.section().splitlines())) <= 110
    *_, useless = tables.sentences([comparison])
    assert useless.startswith(
        "dead learned nothing (test nmse above 0.95); its training drives have 1,200 turning "
    )
    assert table.note.startswith(
        "✓ has the least test error. † 1 of 2 seeds of pointnet2-lstm failed to train. ‡ "
        f"{useless} Test frames that "
    )
    rows = {row["model"]: row for row in table.rows}
    assert "dead ‡" in rows
    row = rows["pointnet2-lstm ✓ †"]
    assert row["nmse"] == "0.232 ± 0.046 (0.179 to 0.309)"
    assert row["parameters"] == "1,408,259"
    assert row["edges"] == "5,160"
    assert rows["*odometry*"]["nmse"] == "0.040"


def test_the_papers_claims_have_verdicts(tmp_path):
    """Claims need both networks as in the paper, and comparable ones are not better."""
    lidar = {"input": "lidar", "semantics": 0.0}
    sets = lidar | {"input": "lidar-pointnet2", "spatial": "pointnet2", "window": 6, "width": 0.25}
    unpruned = {"source": "clouds/pseudo", "k": 6, "keep_inter_class": 1.0}
    models = [
        metrics("sa-gnn-ncp"),
        metrics("lambda-0", semantics=0.0),
        metrics("gnn-ncp", 0.1, **lidar),
        metrics("keep-100", 0.1) | {"variant": unpruned},
        metrics("gnn-lstm", 0.2, **lidar | {"input": "lidar-50k", "temporal": "lstm"}),
        metrics("pointnet2-ncp", 0.4, **sets),
        metrics("do-gnn-ncp", **lidar),
    ]
    (comparison,) = compare(tmp_path, *(model | {"seeds": [0, 1]} for model in models))
    rows = tables.claims_table(comparison).rows
    assert {row["networks"]: (row["here"], row["verdict"]) for row in rows} == {
        "gnn-ncp, pointnet2-ncp": ("0.25", "confirmed"),
        "sa-gnn-ncp, lambda-0": ("1.00", "no difference shown"),
        "sa-gnn-ncp, keep-100": ("2.00", "reversed"),
        "gnn-ncp, gnn-lstm": ("0.50", "reversed"),
    }
    assert rows[0]["MSE ratio: paper"] == "0.55"
    errors = {row["model"]: row for row in tables.results_table(comparison).rows}
    assert errors["gnn-ncp ✓"]["paper: test MSE"] == "0.132"
    assert errors["keep-100"]["paper: test MSE"] == tables.NONE


def test_the_papers_numbers_need_a_claim(tmp_path):
    (comparison,) = compare(tmp_path, metrics("sa-gnn-ncp"), metrics("mine", spatial="pyg"))
    assert tables.claims_table(comparison).rows == []
    assert "paper: test MSE" not in tables.results_table(comparison).heads


def test_the_best_model_is_compared_with_the_best_baseline_and_the_other_models(tmp_path):
    path = {"predict": "path", "baselines": {"odometry": 0.4}}
    (comparison,) = compare(
        tmp_path, metrics("path-blind", 0.5, predict="path"), metrics("path", 0.2, **path)
    )
    differences = tables.differences_table(comparison).rows
    assert [row["models"] for row in differences] == ["path − odometry", "path − path-blind"]
    expected = "-0.300 (-0.300 to -0.300) too few seeds (train.seeds)"
    assert differences[1]["5-10 m"] == expected
    rows = {row["model"]: row for row in tables.results_table(comparison).rows}
    assert rows["path ✓"]["nmse 0-5 m"] == "0.200 (0.200 to 0.200)"
    assert rows["*odometry*"]["nmse 5-10 m"] == "0.400"


@pytest.mark.parametrize(
    ("nmse", "baselines", "verdict"),
    [
        (0.2, {}, "Zero, without a network, has 1.000. Verdict on the difference: better."),
        (
            0.2,
            {"odometry": 0.6},
            "Odometry, without a network, has 0.600. Verdict on the difference: better.",
        ),
        (
            0.2,
            {"odometry": 0.6, "regression": 0.4, "persistence": 0.01},
            "Regression, without a network, has 0.400. Verdict on the difference: better.",
        ),
        ([0.1, 0.4], {"odometry": 0.3}, ": no difference shown."),
        (0.6, {"odometry": 0.05}, ": worse."),
    ],
)
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_best_validated_model_has_a_verdict(
    tmp_path, monkeypatch, nmse, baselines, verdict, predict
):
    """Methods are compared with two seeds.

    The two drives have ten parts that count as drives, or eight.
    """
    models = [
        metrics("other", 0.01, baselines, predict=predict),
        metrics("net", nmse, baselines, predict=predict),
    ]
    for model, errors in zip(models, ((0.4, 0.4), (0.1, 0.5)), strict=True):
        values = zip(model["test"], errors, strict=False)
        model["val"] = {name: {"nmse": value, "nmse_by_seed": [value]} for name, value in values}
    headline, text, _ = tables.sentences(compare(tmp_path, *models))
    assert headline.endswith(": too few seeds (train.seeds).")

    title, metres = {"angle": ("steering angle", 1), "path": ("turn of the path ahead", 10)}[
        predict
    ]
    driven_rad = 0.01 * metres * np.delete(np.arange(7, 30), 13).mean()
    mae_deg = np.rad2deg(driven_rad * np.sqrt(nmse).mean())
    choice = "net is the model with the least validation error: its mean absolute error of the "
    assert f"{choice}{title} is {mae_deg:.2f} deg, " in text

    for model in models:
        model["seeds"] = [0, 1]
    headline, *_ = tables.sentences(compare(tmp_path, *models))
    assert f"with an error (nmse) of {np.mean(nmse):.3f}, " in headline
    assert headline.endswith(verdict)
    blocks = examples.SETTINGS.model_copy(update={"bootstrap_block_frames": 6})
    monkeypatch.setattr(examples, "SETTINGS", blocks)
    headline, *_ = tables.sentences(compare(tmp_path, *models))
    assert headline.endswith(": too few drives.")


def test_few_turning_frames_are_doubted(tmp_path):
    comparisons = compare(tmp_path, metrics("net") | {"turning_frames": 19})
    assert tables.few_turns(comparisons) == [
        "19 frames of the training drives turn (radius below 135 m), too few to tell models apart"
    ]
    assert tables.few_turns(compare(tmp_path, metrics("net") | {"turning_frames": 20})) == []


def test_perception_has_a_row_per_split_with_ground_truth():
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["test"].add_depth("depth_dense", truth, truth)
    outside_of_the_crop = np.where(np.arange(40)[:, None] < 2, truth, 0)
    scores["train"].add_depth("depth_dense", truth, outside_of_the_crop)
    report = {split: score.report() for split, score in scores.items()} | {"motion": {}}
    assert tables.perception_tables(report)[0].cells == [  # without the columns of flat ground
        ["val", "lidar", "1", "100.0%", "0.200, 2.00, 1.000"],
        ["test", "dense", "1", "100.0%", "0.000, 0.00, 1.000"],
    ]
