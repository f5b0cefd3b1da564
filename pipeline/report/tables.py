"""Write the values of results.json as tables of text, and as sentences."""

import math
import re
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any, NamedTuple

import pandas as pd

from pipeline.base.params import SPLITS
from pipeline.evaluate import statistics
from pipeline.evaluate.own_metrics import METRICS
from pipeline.evaluate.settings import BASELINES, NO_LEARNING
from pipeline.report import paper
from pipeline.report.values import (
    Task,
    best_baseline,
    is_validated,
    lead_errors,
    lead_label,
    list_ends,
    list_methods,
    list_models,
    list_ranges,
    measure_of,
    quantity_of,
    rank_models,
    read_difference,
    title_of,
    with_scene,
    without_scene,
)
from pipeline.train.quantity import NMSE, Measure, Quantity

# Text of a cell without a value.
NONE = "–"
# Share of the error that leads above which a drive is named.
LARGE_SHARE = 0.25
# Number of turning frames in the training drives below which models cannot be told apart.
LEAST_TURNING = 20
# Words of tables and sentences → their meanings. Those of a text define only what it names.
DEFINITIONS = {
    "displacement": (
        "the distance between the predicted and the driven path after a length of path, both with "
        "the mean curvature of each range; the mean over frames, so that slow stretches count more "
        "per metre. It resembles the final displacement error (FDE) of other work, but compares at "
        "equal lengths instead of equal times."
    ),
    "nmse": (
        "MSE / MSE of always predicting zero: 0 is perfect, 1 is useless. Without a range, it is "
        "the mean over the ranges."
    ),
    "interval": (
        "in parentheses or below an error stands its 95 % interval, bootstrapped over roads and "
        "seeds. After ± stands the standard deviation between seeds."
    ),
    "MAE": "mean absolute error, with its unit.",
    "drift": (
        "how far the path that follows from the predicted angles ends from that of the labelled "
        "angles, m per 100 m of way (Figure 5 of the paper). Both have the measured speed."
    ),
    "edges": "directed kNN edges per frame after pruning, of networks that get them.",
    "paper: test MSE": (
        "MSE in the paper's Table 2. It is too large for rad² of this label (docs/paper.md), so "
        "only ratios can be compared."
    ),
    **{name: f"a baseline: {meaning}." for name, meaning in NO_LEARNING.items()},
    "persistence": "a baseline: the last true value, which no model gets.",
    "differences": (
        "paired differences of errors, mean over the seeds, with their 95 % intervals: below 0, "
        "the first is better. A verdict is read from the printed bounds, of one error only. One "
        "seed is too few to compare methods: add some to train.seeds. Fewer than ten drives are "
        "too few, too."
    ),
    "the paper's claims": (
        "nmse and mean absolute error of both networks; MSE of the first relative to the second's, "
        "in the paper's Table 2 and here; the verdict is by the paired difference in nmse."
    ),
    "error / depth": (
        "mean over frames of the mean of |d − d*| / d*, of depths from 1 to 80 m in KITTI's Eigen "
        "crop. Only pixels with a predicted depth d and a true depth d* count."
    ),
    "within 25 %": "share of the pixels whose d / d* is between 1 / 1.25 and 1.25.",
    "coverage": "share of the pixels with a true depth that have a predicted one.",
    "level road": (
        "depth by a level road on the same pixels, which an encoder that has learned depth beats."
    ),
    "mean IoU": "intersection over union, mean over the classes in the truth.",
    "frames measured": (
        "share of the frames whose motion is measured in the images. A frame that is not measured "
        "has the angle of the frame before."
    ),
}
# Part of the scores → title of its table.
SCORES = {
    "depth_dense": "Depth, compared with dense truth",
    "depth_lidar": "Depth, compared with LiDAR",
    "ground_plane_dense": "Depth of a level road, compared with dense truth",
    "ground_plane_lidar": "Depth of a level road, compared with LiDAR",
    "classes": "Classes, compared with dense truth",
    "motion": "Motion by visual odometry, compared with recorded motion",
}
# Score → its column.
SCORE_HEADS = {
    "abs_rel": "error / depth",
    "rmse_m": "RMSE, m",
    "delta1": "within 25 %",
    "mean_iou": "mean IoU",
    "pixel_accuracy": "pixel accuracy",
    "valid": "frames measured",
    "judged": "frames with an angle",
    "yaw_rmse_degps": "yaw rate: RMSE, deg/s",
    "yaw_median_degps": "yaw rate: median error, deg/s",
    "speed_ratio": "speed: measured / recorded",
    "nmse": "nmse of the angle",
}


class Section(NamedTuple):
    """A table of text with a title and a note. The index of the table is its first column."""

    title: str
    table: pd.DataFrame
    note: str = ""

    def markdown(self) -> str:
        """Return title, table and note in Markdown."""
        note = f"\n\n{fill(self.note, 110)}" if self.note else ""
        return f"## {self.title}\n\n{to_markdown(self.table)}{note}"


def to_markdown(table: pd.DataFrame) -> str:
    """Return a table in Markdown, with the index left- and the columns right-aligned."""
    table = table.reset_index()
    lines = [table.columns.tolist(), *table.to_numpy().tolist()]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]

    # In the line below the headings, a colon aligns a column to the right.
    rule = ["-" * widths[0]]
    rule += ["-" * (width - 1) + ":" for width in widths[1:]]
    lines.insert(1, rule)
    rows = []
    for first, *others in lines:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        rows.append(f"| {' | '.join([first.ljust(widths[0]), *cells])} |")
    return "\n".join(rows)


def value_text(value: Any, form: str = "") -> str:
    """Return a value as text with a typographic minus, or NONE if it is missing."""
    return NONE if pd.isna(value) else format(value, form).replace("-", "−")


def error_text(row: pd.Series, measure: Measure) -> str:
    """Return the error of a row, or NONE if it has none."""
    value = statistics.value_of(row)
    return NONE if value is None else statistics.number_text(value, measure)


def difference_text(row: Mapping[str, Any] | pd.Series, form: str) -> str:
    """Return the difference of a row as text with a typographic minus."""
    value = statistics.value_of(row)
    return NONE if value is None else statistics.signed_text(value, form).replace("-", "−")


def bounds_text(row: Mapping[str, Any] | pd.Series, form: str) -> str:
    """Return the interval of a row of differences as text with a typographic minus."""
    return statistics.bounds_text(row, form).replace("-", "−")


def with_unit(text: str, measure: Measure) -> str:
    """Return a number as text with the unit of its measure."""
    return f"{text} {measure.unit}".strip()


def _table_of(rows: Mapping[str, Mapping[str, str]], name: str) -> pd.DataFrame:
    """Return a table of rows. `name` is that of its index."""
    table = pd.DataFrame.from_dict(rows, orient="index").fillna(NONE).rename_axis(name)
    return without_dashes(table)


def without_dashes(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table without rows and columns that have no value."""
    has_value = table != NONE
    return table.loc[has_value.any(axis=1), has_value.any()]


# Sentences


def write_sentences(values: pd.DataFrame, absent: Sequence[str] = ()) -> list[str]:
    """Return sentences on the results: the verdict, its interval, and one on each task.

    Names of models are between backticks, and those of baselines between asterisks. `absent` are
    models without results on this machine, which the last sentence names.
    """
    # A task without an error, for instance since its test has no bend, has no sentence.
    tasks = []
    for task in values.index.unique("task"):
        table = values.loc[task]
        if statistics.value_of(table.loc[(lead_label(table), rank_models(table)[0])]) is not None:
            tasks.append(task)
    lines = []
    if tasks:
        table = values.loc[tasks[0]]
        lines = [_write_headline(table, tasks[0]), _describe_difference(table, tasks[0])]
        explained = {measure_of(table, tasks[0], lead_label(table))}
        _, rival = _choose_pair(table)
        # A headline that compares with a baseline needs no further sentence on the first task.
        further = tasks[1:] if rival in BASELINES else tasks
        for task in further:
            table = values.loc[task]
            line = _compare_with_baseline(table, task)
            measure = measure_of(table, task, lead_label(table))
            if measure not in explained:
                line += f" {_explain_measure(table, measure)}"
            lines.append(line)
            explained.add(measure)
    if absent:
        lines.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull "
            "--allow-missing train evaluate, then dvc repro --pull --allow-missing"
        )
    return lines


def _choose_pair(table: pd.DataFrame) -> tuple[str, str]:
    """Return the two methods that the headline compares.

    These are the best model with the scene and the best one without it, whichever is better. If
    there are not both, they are the best model and the best baseline.
    """
    seeing = with_scene(table)
    blind = without_scene(table)
    if seeing and blind:
        return seeing, blind
    return rank_models(table)[0], best_baseline(table)


def _write_headline(table: pd.DataFrame, task: str) -> str:
    """Return the verdict on two methods with both errors, in at most 20 words."""
    name, rival = _choose_pair(table)
    label = lead_label(table)
    error, rival_error = _shorten_pair(table, task, name, rival)
    title = title_of(task)
    # A comma opens the number of frames ahead, and another one closes it.
    comma = "," if "," in title else ""
    clause = f"the nmse of the {title}{comma} is"
    if label:
        clause = f"the {title} ({label}){comma} is off by"

    verdict = read_difference(table, name, rival)["verdict"]
    if rival in BASELINES:
        if verdict == "better":
            return f"`{name}` is better than *{rival}*: {clause} {error} instead of {rival_error}."
        if verdict == "worse":
            return f"*{rival}* is better than `{name}`: {clause} {rival_error} instead of {error}."
        return f"No difference shown: {clause} {error} with `{name}`, {rival_error} with *{rival}*."
    if verdict == "better":
        return f"The scene helps: {clause} {error} instead of {rival_error}."
    if verdict == "worse":
        return f"Worse with the scene: {clause} {error} instead of {rival_error}."
    return f"No difference shown: {clause} {error}, without the scene {rival_error}."


def _shorten_pair(table: pd.DataFrame, task: str, name: str, rival: str) -> list[str]:
    """Return the errors of two methods with two digits, or with as many as tell them apart.

    Errors that differ in none of the further decimal places have those of tables.
    """
    measure = measure_of(table, task, lead_label(table))
    errors = lead_errors(table)[[name, rival]].tolist()
    texts = [_two_digits(error, measure) for error in errors]
    for digits in range(measure.digits, measure.digits + statistics.FURTHER_DIGITS + 1):
        if _are_apart(errors, texts):
            break
        texts = [f"{error:.{digits}f}" for error in errors]
    if not _are_apart(errors, texts):
        texts = [statistics.number_text(error, measure) for error in errors]
    return [with_unit(text, measure) for text in texts]


def _two_digits(error: float, measure: Measure) -> str:
    """Return an error with two significant digits, and no more decimal places than in tables."""
    digits = 1 - math.floor(math.log10(error)) if error else 0
    return f"{error:.{min(max(digits, 0), measure.digits)}f}"


def _are_apart(errors: Sequence[float], texts: Sequence[str]) -> bool:
    """Return whether the texts of two errors differ, and only an error of 0 prints as 0."""
    for error, text in zip(errors, texts, strict=True):
        if error and not text.strip("0."):
            return False
    return texts[0] != texts[1]


def _describe_difference(table: pd.DataFrame, task: str) -> str:
    """Return the difference that the headline is read from, its interval, basis and meaning."""
    name, rival = _choose_pair(table)
    label = lead_label(table)
    measure = measure_of(table, task, label)
    if rival in BASELINES:
        first = _describe_network(table)
        second = f"*{rival}* ({NO_LEARNING[rival]})"
    else:
        first = f"network `{name}`, which sees the scene,"
        second = f"`{rival}`, which does not,"
    title = f"{measure.title} {label}".strip()
    difference = _difference_with_bounds(table, name, rival, measure)
    basis = _describe_basis(table, name, rival)
    meaning = _explain_measure(table, measure)
    return f"The {title} of {first} minus that of {second} is {difference}. {basis} {meaning}"


def _describe_basis(table: pd.DataFrame, name: str, rival: str) -> str:
    """Return a sentence on what a verdict is based on, or why there is none."""
    difference = read_difference(table, name, rival)
    if difference["verdict"] == "too few seeds":
        return "One seed is too few for a verdict: add some to train.seeds."
    if difference["verdict"] == statistics.TOO_FEW_DRIVES:
        parts = "is one" if difference["parts"] == 1 else f"are {difference['parts']}"
        least = statistics.LEAST_DRIVES
        return f"A verdict needs {least} test drives or parts of long ones, and there {parts}."
    row = table.loc[(lead_label(table), name)]
    drives = "one test drive" if row["drives"] == 1 else f"{row['drives']} test drives"
    seeds = "one seed" if len(row["seeds"]) == 1 else f"{len(row['seeds'])} seeds"
    return f"It is the mean over {drives} and {seeds}."


def _explain_measure(table: pd.DataFrame, measure: Measure) -> str:
    """Return what the error that leads is."""
    ranges = list_ranges(table)
    if lead_label(table) or len(ranges) == 1:
        return measure.meaning
    return f"{measure.meaning} Here it is the mean over the ranges {', '.join(ranges)}."


def _describe_network(table: pd.DataFrame) -> str:
    """Return the name of the best model, and by which error it is the best of several."""
    text = f"network `{rank_models(table)[0]}`"
    if len(list_models(table)) == 1:
        return text
    if is_validated(table):
        return f"{text} (with the least validation error)"
    return f"{text} (with the least test error, since there is no validation)"


def _difference_with_bounds(table: pd.DataFrame, name: str, rival: str, measure: Measure) -> str:
    """Return the paired difference of a model from another or a baseline, with its interval."""
    row = read_difference(table, name, rival)
    difference = with_unit(difference_text(row, measure.signed_form), measure)
    if pd.isna(row["low"]):
        of_model = table.loc[(lead_label(table), name)]
        return f"{difference} ({statistics.no_interval_text(of_model)})"
    bounds = with_unit(bounds_text(row, measure.signed_form), measure)
    return f"{difference}, 95 % interval {bounds}"


def _compare_with_baseline(table: pd.DataFrame, task: str) -> str:
    """Return a sentence that compares the best model of a task with the best baseline."""
    name = rank_models(table)[0]
    baseline = best_baseline(table)
    label = lead_label(table)
    measure = measure_of(table, task, label)
    error, baseline_error = _shorten_pair(table, task, name, baseline)
    verdict = read_difference(table, name, baseline)["verdict"]

    network = _describe_network(table)
    without = f"*{baseline}* ({NO_LEARNING[baseline]})"
    if verdict == "better":
        text = f"{network} is better than the best prediction without a network, {without}"
        order = f"{error} instead of {baseline_error}"
    elif verdict == "worse":
        verb = "is better than"
        if baseline == "odometry" and not quantity_of(task).is_ahead:
            verb = "measures it better than"
        text = f"{without} {verb} {network}"
        order = f"{baseline_error} instead of {error}"
    else:
        text = f"no difference is shown between {network} and {without}"
        order = f"{error} and {baseline_error}"
    title = title_of(task)
    by = f"{measure.title} {label}".strip()
    difference = _difference_with_bounds(table, name, baseline, measure)
    return (
        f"{title[:1].upper()}{title[1:]}: {text}, by the {by}: {order}. The difference, "
        f"`{name}` minus *{baseline}*, is {difference}."
    )


def few_turns(values: pd.DataFrame) -> list[str]:
    """Return doubts: one if the training drives have too few bends, otherwise none."""
    least = values["turning_frames"].min()
    if pd.isna(least) or least >= LEAST_TURNING:
        return []
    problem = f"{least} frames of the training drives turn (radius below 135 m)"
    return [f"{problem}, too few to tell models apart"]


def few_drives(values: pd.DataFrame) -> list[str]:
    """Return doubts: one if the test drives are too few for a verdict, otherwise none."""
    if statistics.TOO_FEW_DRIVES not in values["verdict"].to_numpy():
        return []
    least = f"at least {statistics.LEAST_DRIVES} are needed, and a long drive counts as several"
    return [f"the test drives are too few ({least}), so their errors mean nothing for other roads"]


# Tables of steering. With `page`, they are those of index.html, which have an interval below its
# value. Values of all ranges together have the range "".


def results_table(values: pd.DataFrame, task: str, *, page: bool = False) -> Section:
    """Return the errors of models and baselines: those at each end, or nmse if there are no ends.

    If the models can judge a claim of the paper, the paper's errors stand beside them.
    """
    table = values.loc[task]
    chosen = rank_models(table)[0]
    with_paper = claims_table(values, task).table.size > 0
    notes = [f"✓ has the least {'validation' if is_validated(table) else 'test'} error."]
    rows = {}
    for name in list_methods(table):
        row = table.loc[("", name)]
        cells = {}
        if with_paper:
            published = paper.NETWORKS[name] if row["paper"] is True else None
            cells["paper: train MSE"] = value_text(published and published.train_mse, ".3f")
            cells["paper: test MSE"] = value_text(published and published.test_mse, ".3f")
            cells["MSE, rad²"] = value_text(row["mse"], "#.3g")
        if list_ends(table):
            cells |= _end_cells(table, name, quantity_of(task), page=page)
        else:
            cells |= _nmse_cells(table, name, quantity_of(task), page=page)
        cells["drift"] = value_text(row["drift"], ".1f")
        cells["parameters"] = value_text(row["parameters"], ",d")
        cells["edges"] = value_text(row["edges"], ",.0f")

        marks = " ✓" if name == chosen else ""
        stuck = row["untrained"]
        if isinstance(stuck, list) and stuck:
            marks += " †"
            notes.append(f"† {len(stuck)} of {len(row['seeds'])} seeds of {name} failed to train.")
        rows[_first_cell(name, page=page) + marks] = cells
    notes += _name_worst(table, chosen)
    notes.append(_count_frames(table, chosen, list_ends(table) or list_ranges(table)))
    return Section(f"Results: {title_of(task)}", _table_of(rows, "model"), " ".join(notes))


def nmse_tables(values: pd.DataFrame, task: str, *, page: bool = False) -> list[Section]:
    """Return the nmse by range and its differences, or none if :func:`results_table` has them."""
    table = values.loc[task]
    if not list_ends(table):
        return []
    rows = {}
    for name in list_methods(table):
        cells = _nmse_cells(table, name, quantity_of(task), page=page)
        rows[_first_cell(name, page=page)] = cells
    note = _count_frames(table, rank_models(table)[0], list_ranges(table))
    errors = Section(f"nmse by range: {title_of(task)}", _table_of(rows, "model"), note)
    return [errors, _differences(values, task, "Differences in nmse", list_ranges(table), page)]


def _end_cells(
    table: pd.DataFrame, name: str, quantity: type[Quantity], *, page: bool
) -> dict[str, str]:
    """Return the errors of a method at each end."""
    cells = {}
    for label in list_ends(table):
        cells[f"error {label}, {quantity.measure.unit}"] = _error_cell(
            table.loc[(label, name)], quantity.measure, page=page
        )
    return cells


def _nmse_cells(
    table: pd.DataFrame, name: str, quantity: type[Quantity], *, page: bool
) -> dict[str, str]:
    """Return the nmse of a method by range, its mean absolute error, and its METRICS."""
    cells = {}
    for label in dict.fromkeys(["", *list_ranges(table)]):
        row = table.loc[(label, name)]
        cells[f"nmse {label}".strip()] = _error_cell(row, NMSE, page=page)
        for title, metric in METRICS.items():
            if quantity.unit in metric.units:
                cells[f"{title} {label}".strip()] = value_text(row[title], ".3f")
    mae = table.loc[("", name), "mae"]
    cells[f"MAE {quantity.shown_unit}"] = value_text(mae, quantity.shown_format)
    return cells


def _name_worst(table: pd.DataFrame, name: str) -> list[str]:
    """Return a sentence on the drive that makes a large share of a model's error, or none."""
    row = table.loc[(lead_label(table), name)]
    if pd.isna(row["worst_share"]) or row["worst_share"] <= LARGE_SHARE:
        return []
    error = f"the error {lead_label(table)}".strip()
    percent = f"{100 * row['worst_share']:.0f} %"
    return [f"{row['worst_drive']} has {percent} of {error} of {name}."]


def _count_frames(table: pd.DataFrame, name: str, labels: Sequence[str]) -> str:
    """Return a sentence on the frames that count for each of some labels."""
    frames = [f"{label} {table.loc[(label, name), 'frames']:,}".strip() for label in labels]
    return f"Test frames that every model of the table predicts: {', '.join(frames)}."


def _first_cell(name: str, *, page: bool) -> str:
    """Return the name of a model or baseline as the first cell of its row."""
    if name in BASELINES:
        return f"*{name}*"
    return f"`{name}`" if page else name


def _error_cell(row: pd.Series, measure: Measure, *, page: bool) -> str:
    """Return the text of an error, with the interval of a model's."""
    _, name = row.name
    value = error_text(row, measure)
    if name in BASELINES or value == NONE:
        return value
    if page:
        return f"{value}\n{statistics.error_bounds_text(row, measure)}"
    return statistics.error_text(row, measure)


def differences_table(values: pd.DataFrame, task: str, *, page: bool = False) -> Section:
    """Return the differences of the errors at each end, or in nmse if there are no ends."""
    table = values.loc[task]
    labels = list_ends(table) or list_ranges(table)
    return _differences(values, task, "Differences", labels, page)


def _differences(
    values: pd.DataFrame, task: str, title: str, labels: Sequence[str], page: bool
) -> Section:
    """Return the differences of the best model from the best baseline and the other models."""
    table = values.loc[task]
    best, *others = rank_models(table)
    rows = {}
    for rival in (best_baseline(table), *others):
        cells = {}
        for label in labels:
            row = read_difference(table, best, rival, label)
            measure = measure_of(table, task, label)
            head = f"{label}, {measure.unit}" if measure.unit else label or measure.title
            cells[head] = _difference_cell(row, measure, page=page)
        rows[f"{_first_cell(best, page=page)} − {_first_cell(rival, page=page)}"] = cells
    return Section(f"{title}: {title_of(task)}", _table_of(rows, "models"))


def _difference_cell(row: pd.Series, measure: Measure, *, page: bool) -> str:
    """Return the text of a paired difference, with its interval, and its verdict if it has one."""
    text = difference_text(row, measure.signed_form)
    if text == NONE:
        return NONE
    bounds = bounds_text(row, measure.signed_form)
    verdict = "" if pd.isna(row.get("verdict")) else f" {row['verdict']}"
    return f"{text}{verdict}\n{bounds}" if page else f"{text} ({bounds}){verdict}"


def claims_table(values: pd.DataFrame, task: str) -> Section:
    """Return the paper's claims on networks that the values have, with verdicts."""
    table = values.loc[task]
    form = quantity_of(task).shown_format
    papers = [name for name in rank_models(table) if table.loc[("", name), "paper"] is True]
    rows = {}
    for claim in paper.CLAIMS:
        if claim.model not in papers or claim.rival not in papers:
            continue
        first = table.loc[("", claim.model)]
        second = table.loc[("", claim.rival)]
        row = read_difference(table, claim.model, claim.rival)
        # A claim that both errors are equally large is reversed by a difference of either sign.
        verdicts = {"better": "reversed" if claim.comparable else "confirmed", "worse": "reversed"}
        rows[claim.text] = {
            "verdict": verdicts.get(row["verdict"], row["verdict"]),
            "networks": f"{claim.model}, {claim.rival}",
            "nmse": ", ".join(value_text(model["nmse"], ".3f") for model in (first, second)),
            "mean error, °": ", ".join(value_text(model["mae"], form) for model in (first, second)),
            "MSE ratio: paper": value_text(paper.mse_ratio(claim), ".2f"),
            "here": value_text(first["nmse"] / second["nmse"] if second["nmse"] else None, ".2f"),
            "difference in nmse": _difference_cell(row.drop("verdict"), NMSE, page=False),
        }
    return Section("The paper's claims", _table_of(rows, "the paper's claim"))


def models_table(tasks: Sequence[Task]) -> Section:
    """Return the inputs and settings of all models."""
    rows = {}
    for task in tasks:
        for name, content in task.models.items():
            rows[name] = _model_cells(content)
    return Section("Models", _table_of(rows, "model"))


def _model_cells(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of a model, from its metrics.json."""
    entry = content["entry"]
    cells = {"input": entry["input"]}
    if entry["spatial"] != "blind":
        unpruned = content["edges_per_frame_unpruned"]
        cells["points"] = value_text(content["points_per_frame"], ",.0f")
        cells["edges"] = value_text(content["edges_per_frame"], ",.0f")
        cells["pruned"] = value_text(
            1 - content["edges_per_frame"] / unpruned if unpruned else None, ".0%"
        )
    for part, option in {"spatial": "layer", "temporal": "cell"}.items():
        cells[part] = f"{entry[part]} ({entry[option]})" if option in entry else entry[part]
    for setting in ("semantics", "window", "equivariant", "motion"):
        cells[setting] = value_text(entry.get(setting))
    return cells


# Tables of scores


def scores_tables(scores: Mapping[str, Any]) -> list[Section]:
    """Return a table of each part of scores/metrics.json that has values, with a row per split."""
    if not scores:
        return []
    parts = {split: scores[split] | {"motion": scores["motion"][split]} for split in SPLITS}
    sections = []
    for part in parts["test"]:
        rows = {split: _score_cells(parts[split][part]) for split in SPLITS if parts[split][part]}
        if rows:
            sections.append(Section(SCORES[part], _table_of(rows, "split")))
    return sections


def _score_cells(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of the numbers of a part."""
    cells = {}
    for key, value in values.items():
        if not isinstance(value, dict):
            head = SCORE_HEADS.get(key, key)
            cells[head] = value_text(value, "" if isinstance(value, int) else ".3g")
    return cells


def define_words(text: str) -> dict[str, str]:
    """Return those of DEFINITIONS whose words are in a text."""
    return {
        word: meaning
        for word, meaning in DEFINITIONS.items()
        if re.search(rf"\b{re.escape(word)}(?!\w)", text, re.IGNORECASE)
    }


def write_definitions(text: str) -> str:
    """Return the definitions of the words of a text in Markdown."""
    lines = "## Definitions\n\n"
    for word, meaning in define_words(text).items():
        lines += fill(f"- {word}: {meaning}", 110, subsequent_indent="  ") + "\n"
    return lines
