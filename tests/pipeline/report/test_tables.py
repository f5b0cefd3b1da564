"""Tables of steering, claims and scores, definitions, and the sentences beside them."""

import numpy as np
import pandas as pd

from pipeline.report import (
    definitions,
    number_text,
    scores_tables,
    sentences,
    tables,
    values,
)
from pipeline.scores import motion_scores, pixels
from pipeline.scores.pixels import Scores
from tests.pipeline.report import examples
from tests.pipeline.report.examples import compare, metrics


def test_models_without_common_frames_or_on_straight_roads_have_no_difference(tmp_path):
    table = examples.predictions()
    for model, drive in zip(("scene", "blind"), examples.DRIVES, strict=True):
        examples.write_model(tmp_path, metrics(model), table[table["drive"] == drive])
    _, apart = examples.load(tmp_path, "scene", "blind")
    assert tables.differences_table(apart, "angle-0").table.empty
    assert sentences.write_sentences(apart) == []
    assert sentences.write_sentences(compare(tmp_path, metrics("straight", None))) == []
    assert sentences.write_sentences(compare(tmp_path)) == []


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
    assert errors["keep-100"] == number_text.NONE

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
    headline, line, compared = sentences.write_sentences(table)
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
    headline, line, *_ = sentences.write_sentences(table)
    assert headline == "The scene helps: the nmse of the path ahead is 0.20 instead of 0.50."
    assert "is −0.300, 95 % interval −0.300 to −0.300. It is the mean over 2 test drives" in line
    assert line.endswith("the mean over the ranges 0-5 m, 5-10 m.")


def test_one_test_drive_has_no_interval(tmp_path, monkeypatch):
    """A drive that is longer than a block would be cut into parts."""
    whole_drives = examples.SETTINGS.model_copy(update={"bootstrap_block_s": 20.0})
    monkeypatch.setattr(examples, "SETTINGS", whole_drives)
    baselines = {"odometry": 0.003}
    table = examples.predictions(0.08, baselines=baselines)
    table = table[table["drive"] == examples.DRIVES[0]]
    examples.write_model(tmp_path, metrics("net", 0.08) | {"seeds": [0, 1]}, table)
    _, one_drive = examples.load(tmp_path, "net")
    _, line = sentences.write_sentences(one_drive)
    assert "is +0.077 (one test drive: no interval). A verdict needs" in line
    assert "needs 10 test drives or parts of long ones, and there is one." in line
    cell = tables.results_table(one_drive, "angle-0", page=True).table.loc["`net` ✓", "nmse"]
    assert cell == "0.080\none test drive: no interval"


def test_a_text_gets_the_definitions_of_its_words_only():
    text = "the nmse of *zero*, and its edges; coverages, knowledges"
    assert [*definitions.define_words(text)] == ["nmse", "edges", "zero"]


def test_scores_have_a_table_per_part_and_a_row_per_split():
    scores = {split: Scores() for split in ("train", "val", "test")}
    truth = np.full((40, 50), 10.0)
    scores["val"].add_depth("depth_lidar", 1.2 * truth, truth)
    scores["test"].add_depth("depth_lidar", truth, truth)
    scores["test"].add_classes(np.array([3, 4]), np.array([3, 3]))
    report = {split: score.to_report() for split, score in scores.items()}
    motion = {"drives": 20, "nmse": None, "speed_ratio": 0.99457, "yaw_rmse_degps": 0.27210444}
    report["motion"] = {"train": None, "val": None, "test": motion}
    sections = scores_tables.scores_tables(report)
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
    assert report.keys() | {"motion"} == scores_tables.SCORES.keys()
    for head in scores_tables.SCORE_HEADS.values():
        assert "_" not in head
    numbers = {key for key in motion if "_" in key} | {*pixels.DEPTH_ERRORS}
    assert numbers <= scores_tables.SCORE_HEADS.keys()
