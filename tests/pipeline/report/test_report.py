"""The report: groups of models, tables, sentences, curves, pictures and the page."""

import html
import re
from pathlib import Path

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest

from pipeline.base import store
from pipeline.base.store import DriveReader
from pipeline.camera.camera import Camera, read_camera
from pipeline.camera.classes import ROAD, VOID
from pipeline.check import preset
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.report import figures, paper, plots, summary, tables
from pipeline.report.page import Story, write_page
from pipeline.report.results import Group
from pipeline.report.street_view import (
    HALF_TRACK_M,
    STEP_M,
    View,
    path_steps,
    read_view,
    wheel_tracks,
)
from pipeline.scores.pixels import Scores
from pipeline.train.entry import Entry
from tests import artefacts, street
from tests.pipeline.report import examples
from tests.pipeline.report.examples import metrics

DRIVE = examples.DRIVES[0]


# Groups and networks of the paper


def test_groups_and_rows_are_sorted_with_baselines_last(tmp_path):
    found = examples.groups(
        tmp_path,
        metrics("path", predict="path"),
        metrics("far", baselines={"odometry": 0.5}, horizon=10),
        metrics("ours", spatial="pyg", baselines={"odometry": 0.04}),
        metrics("do-gnn-ncp", baselines={"persistence": 0.01}, input="depth", semantics=0.0),
        metrics("gnn-lstm", input="lidar-50k", temporal="lstm", semantics=0.0),
    )
    assert [group.title for group in found] == [
        "steering angle",
        "steering angle, 10 frames ahead",
        "path ahead",
    ]
    group = found[0]
    assert [*group.predicted] == [
        "gnn-lstm",
        "do-gnn-ncp",
        "ours",
        "zero",
        "train_mean",
        "odometry",
        "persistence",
    ]
    assert group.nmse("odometry")[0] == pytest.approx(0.04)
    assert group.best_baseline == "odometry"
    assert [row["paper"] and row["paper"].test_mse for row in group.models] == [0.130, 0.081, None]
    assert [*found[2].labels.values()] == ["0-5 m", "5-10 m"]


@pytest.mark.parametrize(
    ("name", "narrow"), [("kitti", set()), ("table2", {"pointnet2-lstm", "pointnet2-ncp"})]
)
def test_networks_of_the_presets_are_the_papers(name, narrow):
    entries = {
        model: Entry.model_validate(entry) for model, entry in preset.merged(name)["models"].items()
    }
    found = {model for model, entry in entries.items() if paper.find(model, entry.model_dump(), {})}
    assert found == paper.PAPER.keys() - narrow


def test_a_network_with_the_papers_name_and_other_settings_is_not_the_papers():
    def found(variant: dict[str, int], **change: object) -> paper.Published | None:
        return paper.find("sa-gnn-ncp", examples.ENTRY | change, variant)

    assert found({}, cell="eq4", features=64) == paper.PAPER["sa-gnn-ncp"]
    changes = {
        "temporal": "lstm",
        "semantics": 0.0,
        "alpha": 5.0,
        "equivariant": True,
        "scene": "another",
    }
    assert not any(found({}, **{key: value}) for key, value in changes.items())
    assert found({"accumulate": 8}) is None


def test_angles_in_degrees_are_those_of_the_wheels_or_the_turns_of_a_path(tmp_path):
    angle, path = examples.groups(
        tmp_path, metrics("net", 0.25), metrics("path", 0.25, predict="path")
    )
    for group, name, factor in ((angle, "net", 1), (path, "path", 10)):  # curvature times metres
        row = group.first_seed(name).iloc[10]
        assert (row["true_deg"], row["predicted_deg"]) == pytest.approx(
            np.rad2deg([0.1 * factor, 0.15 * factor])
        )


# Tables and sentences


def build(data: Path, *contents: dict[str, object]) -> dict[str, tables.Table]:
    return {table.title: table for table in steering_tables(examples.groups(data, *contents))}


def steering_tables(groups: list[Group]) -> list[tables.Table]:
    results, paper_tables, details = tables.steering_tables(groups, summary.results(groups))
    return [*results, *paper_tables, *details]


def sentences(groups: list[Group]) -> list[str]:
    return tables.sentences(groups, summary.results(groups))


def test_the_first_table_fits_a_terminal(tmp_path):
    content = metrics("pointnet2-lstm", baselines={"odometry": 0.04}, horizon=10) | {
        "seeds": [0, 1],
        "untrained": [1],
    }
    content["parameters"] = 1_408_259
    first = examples.predictions(0.2, baselines={"odometry": 0.04})
    second, right = examples.predictions(0.3), examples.predictions()["frame"].between(10, 15)
    second.loc[right, "predicted_steering_rad"] = second["true_steering_rad"]
    examples.write_model(
        tmp_path, content, pd.concat([first.assign(seed=0), second.assign(seed=1)])
    )
    examples.write_model(tmp_path, metrics("dead", 0.96, horizon=10))
    table, *_ = steering_tables(groups := examples.load(tmp_path, "pointnet2-lstm", "dead"))
    assert max(map(len, table.markdown().splitlines())) <= 110
    *_, useless = sentences(groups)
    assert useless.startswith(
        "dead learned nothing (test nmse above 0.95); its training drives have 1,200 turning "
    )
    assert table.note.startswith(
        "✓ has the least test error. † 1 of 2 seeds of pointnet2-lstm failed to train. ‡ "
        f"{useless} Test frames that "
    )
    rows = {row["model"]: row for row in table.rows}
    assert "dead ‡" in rows
    found = rows["pointnet2-lstm ✓ †"]
    assert found["nmse"] == "0.232 ± 0.046 (0.179 to 0.309)"
    assert (found["parameters"], found["edges"]) == ("1,408,259", "5,160")
    assert rows["*odometry*"]["nmse"] == "0.040"


def test_the_papers_claims_have_verdicts(tmp_path):
    """Of those with both networks as in the paper. Networks are not comparable where one is
    better.
    """
    lidar = {"input": "lidar", "semantics": 0.0}
    sets = lidar | {"input": "lidar-pointnet2", "spatial": "pointnet2", "window": 6, "width": 0.25}
    models = [
        metrics("sa-gnn-ncp"),
        metrics("lambda-0", semantics=0.0),
        metrics("gnn-ncp", 0.1, **lidar),
        metrics("keep-100", 0.1)
        | {"variant": {"source": "clouds/pseudo", "k": 6, "keep_inter_class": 1.0}},
        metrics("gnn-lstm", 0.2, **lidar | {"input": "lidar-50k", "temporal": "lstm"}),
        metrics("pointnet2-ncp", 0.4, **sets),
        metrics("do-gnn-ncp", **lidar),
    ]
    rows = build(tmp_path, *(content | {"seeds": [0, 1]} for content in models))[
        "The paper's claims"
    ].rows
    assert {row["networks"]: (row["here"], row["verdict"]) for row in rows} == {
        "gnn-ncp, pointnet2-ncp": ("0.25", "confirmed"),
        "sa-gnn-ncp, lambda-0": ("1.00", "no difference shown"),
        "sa-gnn-ncp, keep-100": ("2.00", "reversed"),
        "gnn-ncp, gnn-lstm": ("0.50", "reversed"),
    }
    assert rows[0]["MSE ratio: paper"] == "0.55"


def test_all_rows_are_compared_on_common_frames_with_one_zero(tmp_path):
    """On its own frames the window of 4 is worse, since it also predicts frames 3 to 6. Odometry
    begins at frame 9.
    """
    baselines = {"odometry": 0.5, "regression": 0.5}
    short, long = (examples.predictions(nmse, baselines=baselines) for nmse in (0.3, 0.5))
    for table in (short, long):
        table.loc[table["frame"] < 9, "odometry_steering_rad"] = np.nan
    for frame in (3, 4, 5, 6):
        short.loc[short["frame"] == frame, "predicted_steering_rad"] = 1.0
    examples.write_model(tmp_path, metrics("short", 0.9, window=4), short)
    examples.write_model(tmp_path, metrics("long", 0.5, window=8) | {"seeds": [0, 1]}, long)
    (group,) = examples.load(tmp_path, "long", "short")
    assert [row["model"] for row in group.by_error] == ["short", "long"]
    assert [group.nmse(name)[0] for name in ("short", "long", "zero")] == pytest.approx(
        [0.3, 0.5, 1.0]
    )
    assert {group.scores(name, "steering_rad")["frames"] for name in group.predicted} == {2 * 22}
    assert (
        "short, the model with the least test error (there is no validation), "
        in sentences([group])[0]
    )
    assert group.nmse("short", minus="long") == (pytest.approx(-0.2), pytest.approx([-0.2, -0.2]))
    unknown = (7**2 + 8**2) / sum(np.delete(np.arange(7, 30), 13) ** 2)
    assert group.nmse("odometry")[0] == pytest.approx(0.5 * (1 + unknown))


def test_models_without_common_frames_or_on_straight_roads_have_no_difference(tmp_path):
    table = examples.predictions()
    for model, drive in zip(("scene", "blind"), examples.DRIVES, strict=True):
        examples.write_model(tmp_path, metrics(model), table[table["drive"] == drive])
    groups = examples.load(tmp_path, "scene", "blind")
    built = {table.title: table for table in steering_tables(groups)}
    assert {row["nmse"] for row in built["Differences: steering angle"].rows} == {tables.NONE}
    straight = examples.groups(tmp_path, metrics("straight", None))
    assert sentences(groups) == sentences([]) == sentences(straight) == []


def test_models_that_differ_in_one_setting_have_a_difference(tmp_path):
    lstm = {key: value for key, value in examples.ENTRY.items() if key != "cell"}
    found = build(
        tmp_path,
        metrics("keep-100", 0.3, input="all") | {"variant": {"source": "clouds/pseudo", "k": 6}},
        metrics("lambda-0", 0.4, semantics=0.0),
        metrics("sa-gnn-lstm", 0.1) | {"entry": lstm | {"temporal": "lstm"}},
        metrics("sa-gnn-ncp", 0.2),
        metrics("path", predict="path", input="ahead", baselines={"odometry": 0.4})
        | {"variant": {"k": 0}},
        metrics("path-blind", 0.5, predict="path", spatial="blind"),
        metrics("path-another", 0.5, predict="path", input="ahead", scene="another")
        | {"variant": {"k": 0}},
    )
    angle, path = (
        [row["models"] for row in found[f"Differences: {title}"].rows]
        for title in ("steering angle", "path ahead")
    )
    assert angle == [
        "sa-gnn-lstm − zero",
        "sa-gnn-lstm − sa-gnn-ncp (temporal: lstm → ncp)",
        "sa-gnn-lstm − keep-100",
        "sa-gnn-lstm − lambda-0",
        "keep-100 − sa-gnn-ncp (keep_inter_class: 1.0 → 0.2)",
        "lambda-0 − sa-gnn-ncp (semantics: 0.0 → 1.0)",
    ]
    assert path[1:] == [
        "path − path-blind (spatial: gnn → blind)",
        "path − path-another (scene: same → another)",
    ]
    assert (
        found["Differences: path ahead"].rows[1]["5-10 m"]
        == "-0.300 (-0.300 to -0.300) too few seeds"
    )
    rows = {row["model"]: row for row in found["Results: path ahead"].rows}
    assert (rows["path ✓"]["nmse 0-5 m"], rows["*odometry*"]["nmse 5-10 m"]) == (
        "0.200 (0.200 to 0.200)",
        "0.400",
    )
    # of the only model with the settings of one of its networks
    (row,) = found["The paper's Table 2"].rows
    assert (row["model"], row["paper test"], row["train"]) == ("sa-gnn-ncp", "0.0771", "1.23e-06")


def test_perception_has_a_row_per_split_with_ground_truth():
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["test"].add_depth("depth_dense", truth, truth)
    # outside the crop
    scores["train"].add_depth("depth_dense", truth, np.where(np.arange(40)[:, None] < 2, truth, 0))
    report = {split: score.report() for split, score in scores.items()} | {"motion": {}}
    assert tables.perception_tables(report)[0].cells == [  # without the columns of flat ground
        ["val", "lidar", "1", "100.0%", "0.200, 2.00, 1.000"],
        ["test", "dense", "1", "100.0%", "0.000, 0.00, 1.000"],
    ]


@pytest.mark.parametrize(
    ("nmse", "baselines", "verdict"),
    [
        (0.2, {}, " and 1.000. Difference in nmse -0.800 (-0.800 to -0.800): better."),
        (
            0.2,
            {"odometry": 0.6},
            " and 0.600. Difference in nmse -0.400 (-0.400 to -0.400): better.",
        ),
        (
            0.2,
            {"odometry": 0.6, "regression": 0.4, "persistence": 0.01},
            "learning, regression (a multiple of ",
        ),
        ([0.1, 0.4], {"odometry": 0.3}, "): no difference shown."),
        (0.6, {"odometry": 0.05}, "(+0.550 to +0.550): worse."),
    ],
)
@pytest.mark.parametrize("predict", ["angle", "path"])
def test_the_best_validated_model_has_a_verdict(
    tmp_path, monkeypatch, nmse, baselines, verdict, predict
):
    """Methods are compared with two seeds; the two drives have ten parts that count as drives, or
    eight.
    """
    models = (
        metrics("other", 0.01, baselines, predict=predict),
        metrics("net", nmse, baselines, predict=predict),
    )
    for model, columns in zip(models, ((0.4, 0.4), (0.5, 0.1)), strict=True):
        model["val"] = {
            name: {"nmse": value, "nmse_by_seed": [value]}
            for name, value in zip(model["columns"], columns[::-1], strict=False)
        }
    text, *purpose = sentences(examples.groups(tmp_path, *models))
    assert all(
        "steer measure). net gets only the structure of the scene in front: " in line
        for line in purpose
    )
    assert len(purpose) == bool(baselines)
    title, metres = {"angle": ("steering angle", 1), "path": ("turn of the path ahead", 10)}[
        predict
    ]
    driven_rad = 0.01 * metres * np.delete(np.arange(7, 30), 13).mean()
    mae = (
        f"{np.rad2deg(driven_rad * np.sqrt(nmse).mean()):.2f}° and an nmse of {np.mean(nmse):.3f} "
        "(95 % interval: "
    )
    start = (
        f"net, the model with the least validation error, predicts the {title} with a mean "
        "absolute error of "
    )
    assert f"{start}{mae}" in text
    assert text.endswith(": too few seeds.")
    for model in models:
        model["seeds"] = [0, 1]
    text, *_ = sentences(examples.groups(tmp_path, *models))
    assert verdict in text
    monkeypatch.setattr(
        examples, "SETTINGS", examples.SETTINGS.model_copy(update={"bootstrap_block_frames": 6})
    )
    assert sentences(examples.groups(tmp_path, *models))[0].endswith(": too few drives.")


# Pictures


def test_a_later_file_replaces_what_an_earlier_one_has(tmp_path):
    """The image of ingest; depth and classes of perception, not the ground truth beside the
    image.
    """
    street.write_drive(tmp_path / "ingest", DRIVE, 3)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    image, depth_m, cls = street.scene(2)
    with (
        DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as raw,
        DriveReader(tmp_path / f"perception/{DRIVE}.h5", stage="perception") as perceived,
    ):
        view = read_view(2, raw, perceived)
    np.testing.assert_array_equal(view.rgb, image)
    np.testing.assert_allclose(view.depth_m, depth_m, atol=0.01)
    np.testing.assert_array_equal(view.cls, cls)
    assert [*view.images()] == ["frame 2", "depth", "classes"]
    assert view.xyz is None


CAMERA = Camera(np.array([[100.0, 0, 160], [0, 100, 40], [0, 0, 1]]), (96, 320), 1.5)


def test_a_path_of_ranges_ends_where_its_arcs_do():
    """5 m straight on, then a quarter of a circle of 10 m to the left."""
    left, _ = wheel_tracks(path_steps([0.0, 0.1], [0, 5, 5 + 5 * np.pi]), CAMERA)
    ahead_m = 15 - HALF_TRACK_M  # of the left wheel, at last beside the middle of the track
    np.testing.assert_allclose(
        left[-1], [160 - 100 * 10 / ahead_m, 40 + 100 * 1.5 / ahead_m], atol=2
    )


def test_the_wheels_on_a_straight_road_meet_at_the_horizon():
    left, right = wheel_tracks(np.zeros(200), CAMERA)
    distance_m = STEP_M * np.arange(3, 201)  # nearer steps are not drawn
    np.testing.assert_allclose(left[:, 0], 160 - 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(right[:, 0], 160 + 100 * HALF_TRACK_M / distance_m)
    np.testing.assert_allclose(left[:, 1], 40 + 100 * 1.5 / distance_m)
    uphill, _ = wheel_tracks(np.zeros(200), CAMERA, slope=-0.1)
    np.testing.assert_allclose(uphill[:, 1], left[:, 1] - 10)


@pytest.mark.parametrize("with_classes", [True, False])
def test_pictures_show_what_the_encoder_has(tmp_path, monkeypatch, with_classes):
    titles: list[str] = []
    monkeypatch.setattr(
        "matplotlib.axes.Axes.set_title", lambda _, title, **style: titles.append(title)
    )
    street.write_drive(tmp_path / "ingest", DRIVE, 9)
    street.write_perception(tmp_path / "perception", tmp_path / "ingest", DRIVE)
    files = [
        tmp_path / f"{stage}/{DRIVE}.h5" for stage in ("clouds/pseudo", "ingest", "perception")
    ]
    clouds_drive(files[0], "pseudo", *files[1:], Clouds(max_points=2048, max_depth_m=80.0, seed=0))
    files[1] = tmp_path / f"graphs/semantic/{DRIVE}.h5"
    artefacts.write_graphs(files[1], np.zeros(9), np.arange(9), 80)
    if not with_classes:
        for path in files:
            with h5py.File(path, "a") as file:
                file["cls"][:] = VOID
    table = examples.predictions().query("drive == @DRIVE and frame < 9")
    examples.write_model(tmp_path, metrics("net"), table)
    captions, views = figures.draw(tmp_path / "figures", examples.load(tmp_path, "net"), tmp_path)
    assert [view.frame for view in views] == [0, 1, 2, 3, 4, 5, 6, 8]
    assert [*captions] == ["chain", "angle-0-only"]
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        f"{name}.png" for name in captions
    }
    assert any("classes" in title for title in titles) == with_classes
    (title,) = [title for title in titles if title.startswith("graph from above: 80 points, ")]
    assert title.endswith("directed edges" if with_classes else "; black: no class")


def test_the_largest_error_of_a_typical_drive_is_drawn(tmp_path, monkeypatch):
    drawn: list[np.ndarray] = []
    monkeypatch.setattr(
        "matplotlib.axes.Axes.plot",
        lambda _, *track, **style: drawn.append(np.stack(track, axis=1)),
    )
    street.write_drive(tmp_path / "ingest", DRIVE, 30)
    for model, nmse in (("worse", 0.9), ("best", 0.0)):
        table = examples.predictions(nmse, examples.PATH)
        for column in examples.PATH:
            table.loc[(table["drive"] == DRIVE) & (table["frame"] == 12), f"predicted_{column}"] = (
                0.3
            )
        examples.write_model(tmp_path, metrics(model, nmse, predict="path"), table)
    captions, _ = figures.draw(
        tmp_path / "figures", examples.load(tmp_path, "worse", "best"), tmp_path
    )
    assert captions["path-0-worst"].startswith(
        "Frame 12, the largest error of best in this drive: driven 68.8° (red)"
    )
    with store.DriveReader(tmp_path / f"ingest/{DRIVE}.h5", stage="ingest") as images:
        camera = read_camera(images)
    expected = [
        track
        for driven_1pm in (0.12, 0.3)
        for track in wheel_tracks(np.full(20, driven_1pm), camera)
    ]
    for track, of_path in zip(drawn, expected, strict=True):  # driven and predicted, left and right
        np.testing.assert_allclose(track, of_path)


# The page


EVIL = "x</script><script>alert(1)</script>"
SECTIONS = [
    "Errors",
    "From image to graph",
    "Results",
    "Test drives: steering angle",
    "Test drives: steering angle, 10 frames ahead",
    "Test drives: path ahead",
    "Learning curves",
    "Models in detail",
    "Definitions",
]


def test_the_page_is_complete_self_contained_and_runs_no_script_of_a_name(tmp_path):
    contents = metrics("sa-gnn-ncp"), metrics("ahead", horizon=10), metrics("path", predict="path")
    groups = examples.groups(tmp_path, *contents)
    groups[0].predictions["drive"] = groups[0].predictions["drive"].replace(DRIVE, EVIL)
    (tmp_path / "figures").mkdir()
    for name in ("angle-0-worst", "chain"):
        cv2.imwrite(str(tmp_path / f"figures/{name}.png"), np.full((60, 200, 3), 90, np.uint8))
    (tmp_path / "learning").mkdir()
    (tmp_path / "learning/sa-gnn-ncp.csv").write_text("epoch,train_loss,val_nmse\n1,0.7,nan\n")
    view = View(
        7,
        xyz=np.array([[1.0, 2, 3], [4, 5, 6]]),
        points_cls=np.full(2, ROAD),
        edges=np.array([[0, 1]]),
    )
    results = summary.results(groups)
    story = Story("Found.", ["A sentence <b>."], ["a clock is late"], "revision 1234567")
    pictures = {"chain": "Figure 1.", "angle-0-worst": "Error."}, [view]
    built = tables.steering_tables(groups, results)
    write_page(tmp_path / "index.html", story, groups, results, built, [], pictures)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", text)] == SECTIONS
    assert re.findall(r'<a href="#(.*?)">', text) == re.findall(r'<section id="(.*?)">', text)
    own = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.DOTALL)  # without plotly
    assert not re.findall(r'(?:src|href)="(?!#|data:)', own)
    found = [
        "Found.",
        "Doubt: a clock is late",
        "A sentence &lt;b&gt;.",
        "<h2>Errors",
        "Figure 1.",
        "<h2>Results",
    ]
    assert [own.index(text) for text in found] == sorted(own.index(text) for text in found)
    assert "revision 1234567" in own
    names = re.findall(r'Plotly\.newPlot\(\s*"(.*?)"', own)
    # in space, learning curves; errors and two drives each
    assert len({*names}) == len(names) == 2 + 3 * len(groups)
    assert "alert(1)" in own
    assert "<script>alert(1)" not in own


def test_points_have_a_trace_per_class_and_edges_one_in_each_frame():
    xyz, edges = np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]]), np.array([[1, 2]])
    views = [View(7, xyz=xyz, points_cls=np.array([ROAD, ROAD, VOID]), edges=edges)]
    views += [View(9, xyz=xyz[:1], points_cls=np.array([ROAD]), edges=edges[:0])]
    figure = plots.in_space(views)
    assert [step.label for step in figure.layout.sliders[0].steps] == [
        frame.name for frame in figure.frames
    ]
    road, void, line = figure.data
    assert (road.name, road.marker.color, void.name) == ("road", "rgb(128, 64, 128)", "no class")
    assert {*zip(road.x, road.y, road.z, strict=True)} == {(1, 3, -2), (4, 6, -5)}
    np.testing.assert_array_equal(
        [line.x, line.y, line.z], [[4, 7, np.nan], [6, 9, np.nan], [-5, -8, np.nan]]
    )
    assert [[len(trace.x) for trace in frame.data] for frame in figure.frames] == [
        [2, 1, 3],
        [1, 0, 0],
    ]


def test_a_network_without_validation_has_its_training_loss(tmp_path):
    columns = {"epoch": [1, 2], "train_loss": [0.7, 0.5], "val_nmse": [0.6, np.nan]}
    curves = {
        "net": pd.DataFrame(columns),
        "net.seed-1": pd.DataFrame(columns | {"val_nmse": np.nan}),
    }
    first, second = plots.learning(
        curves, plots.styles(examples.groups(tmp_path, metrics("net")))
    ).data
    np.testing.assert_allclose(first.y, columns["val_nmse"], rtol=1e-6)
    np.testing.assert_allclose(second.y, columns["train_loss"], rtol=1e-6)
    assert (first.legendgroup, first.showlegend, second.showlegend) == ("net", True, False)
