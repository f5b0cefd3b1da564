"""The headline and the other sentences on the results, and doubts."""

import re

import numpy as np
import pytest

from pipeline.report import (
    sentences,
    values,
)
from tests.pipeline.report import examples
from tests.pipeline.report.examples import compare, metrics


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
    headline, line, *_ = sentences.write_sentences(table)
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
    headline, line, compared = sentences.write_sentences(table)
    assert headline.startswith(start.format("the nmse of the steering angle is"))
    assert "of network `net`, which sees the scene, minus that of `net-blind`" in line
    assert "network `net-blind` (with the least validation error)" in compared


def test_errors_get_digits_until_they_differ(tmp_path):
    """Ten frames ahead, whose number is between commas."""
    baselines = {"regression": 0.3104}
    for nmse, texts in ((0.3101, "0.3101 with `net`, 0.3104"), (0.3104, "0.310 with `net`, 0.310")):
        rows = compare(tmp_path, metrics("net", nmse, baselines, horizon=10))
        headline, *_ = sentences.write_sentences(rows)
        subject = "the nmse of the steering angle, 10 frames ahead, is"
        assert headline == f"No difference shown: {subject} {texts} with *regression*."


def test_a_sentence_says_that_odometry_measures_the_present_angle_better(tmp_path):
    baselines = {"odometry": 0.003}
    net = metrics("net", 0.08, baselines) | {"seeds": [0, 1]}
    blind = metrics("blind", 0.5, baselines, spatial="blind") | {"seeds": [0, 1]}
    *_, line = sentences.write_sentences(compare(tmp_path, net, blind))
    assert line.startswith("Steering angle: *odometry* (what the images show")
    assert "measures it better than network `net`" in line
    assert "by the nmse: 0.003 instead of 0.080. The difference, `net` minus *odometry*" in line


@pytest.mark.parametrize(
    ("frames", "doubts"),
    [
        ([19], ["19 frames of the training drives turn"]),
        ([20], []),
        ([None], []),
        ([None, 19], ["19 frames of the training drives turn"]),
    ],
)
def test_few_turning_frames_are_doubted(tmp_path, frames, doubts):
    """A quantity that does not determine a path has no number of them."""
    models = []
    for number, turning in enumerate(frames):
        models.append(metrics(f"net-{number}", horizon=number) | {"turning_frames": turning})
    found = sentences.few_turns(compare(tmp_path, *models))
    assert [doubt.partition(" (")[0] for doubt in found] == doubts


def test_drives_without_measured_motion_are_named(tmp_path):
    content = metrics("net", baselines={"odometry": 0.1})
    table = examples.predictions(baselines={"odometry": 0.1})
    for drives in ([], [examples.DRIVES[1]]):
        table.loc[table["drive"].isin(drives), "odometry_steering_rad"] = np.nan
        examples.write_model(tmp_path, content, table)
        tasks, _ = examples.load(tmp_path, "net")
        text = "no motion is measured in {}, where odometry and regression count as 0"
        assert sentences.unmeasured_drives(tasks) == [text.format(drive) for drive in drives]
