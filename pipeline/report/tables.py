"""Write the values of results.json as tables of text, and as sentences."""

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
    lead_label,
    list_ends,
    list_methods,
    list_ranges,
    measure_of,
    quantity_of,
    rank_models,
    read_difference,
    title_of,
    without_scene,
)
from pipeline.train.quantity import NMSE, Measure, Quantity

# Text of a cell without a value.
NONE = "–"
# Share of the error that leads above which a drive is named.
LARGE_SHARE = 0.25
# Number of turning frames in the training drives below which models cannot be told apart.
LEAST_TURNING = 20
# Words that the tables use → their meanings.
DEFINITIONS = {
    "error at an end": (
        "the distance between the predicted and the driven path after that length of path, both "
        "with the mean curvature of each range; the mean over frames, so that slow stretches count "
        "more per metre. It resembles the final displacement error (FDE) of other work, but "
        "compares at equal lengths instead of equal times."
    ),
    "nmse": (
        "MSE / MSE of always predicting zero: 0 is perfect, 1 is useless. Without a range, it is "
        "the mean over the ranges."
    ),
    "intervals": (
        "after ± stands the standard deviation between seeds. In parentheses or below stands the "
        "95 % interval, bootstrapped over roads and seeds."
    ),
    "MAE": "mean absolute error, with its unit.",
    "drift": (
        "how far the path that follows from the predicted angles ends from that of the labelled "
        "angles, m per 100 m of way (Figure 5 of the paper). Both have the measured speed."
    ),
    "edges": "directed kNN edges per frame after pruning, of networks that get them.",
    "paper": (
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
    "claims": (
        "nmse and mean absolute error of both networks; MSE of the first relative to the second's, "
        "in the paper's Table 2 and here; the verdict is by the paired difference in nmse."
    ),
    "scores": (
        "means over frames of the errors of the encoder's depth, from 1 to 80 m in KITTI's Eigen "
        "crop. Only pixels with a predicted depth count, and coverage is their share. "
        "ground_plane_… is a level road on the same pixels, which an encoder that has learned "
        "depth beats. mean_iou is over the classes in the truth. motion is measured in images, and "
        "compared with recorded motion. valid is the share of the frames that are measured. nmse "
        "is that of the steering angle, over `judged` frames. A frame that is not measured has the "
        "angle of the frame before."
    ),
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


def bounds_text(row: Mapping[str, Any] | pd.Series, form: str) -> str:
    """Return the interval of a row of values as text with a typographic minus."""
    return statistics.bounds_text(row, form).replace("-", "−")


def error_text(row: pd.Series, measure: Measure, form: str = "") -> str:
    """Return the error of a row with its unit."""
    value = value_text(statistics.value_of(row), form or measure.form)
    return f"{value} {measure.unit}".strip()


def interval_text(row: pd.Series, measure: Measure, form: str = "") -> str:
    """Return the interval of a row with its unit."""
    unit = "" if pd.isna(row["low"]) else measure.unit
    return f"{bounds_text(row, form or measure.form)} {unit}".strip()


def _table_of(rows: Mapping[str, Mapping[str, str]], name: str) -> pd.DataFrame:
    """Return a table of rows, without columns that have no value. `name` is that of its index."""
    table = pd.DataFrame.from_dict(rows, orient="index").fillna(NONE).rename_axis(name)
    return table.loc[:, (table != NONE).any()]


# Sentences


def write_sentences(values: pd.DataFrame, absent: Sequence[str] = ()) -> list[str]:
    """Return sentences on the results: the question with its answer, the verdict, and more.

    Names of models are between backticks, and those of baselines between asterisks. `absent` are
    models without results on this machine, which the last sentence names.
    """
    lines: list[str] = []
    for task in values.index.unique("task"):
        lines = _describe_best(values.loc[task], task)
        if lines:
            break
    if absent:
        lines.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull "
            "--allow-missing train evaluate, then dvc repro --pull --allow-missing"
        )
    return lines


def _describe_best(table: pd.DataFrame, task: str) -> list[str]:
    """Return sentences on the best model, or none if it has no error: the test has no bend."""
    name = rank_models(table)[0]
    label = lead_label(table)
    rows = table.loc[label]
    row = rows.loc[name]
    if statistics.value_of(row) is None:
        return []
    quantity = quantity_of(task)
    measure = measure_of(table, task, label)
    blind = without_scene(table)
    baseline = best_baseline(table)
    baseline_error = error_text(rows.loc[baseline], measure)

    # The headline compares with a network that lacks the scene, if there is one.
    drives = "1 drive" if row["drives"] == 1 else f"{row['drives']} drives"
    title = f"{measure.title} {label}".strip()
    error = f"an error ({title}) of {error_text(row, measure)} on {drives} that it was not trained "
    error += "on"
    if blind and table.loc[("", name), "scene"]:
        rival = f"`{blind}`"
        question = f"Does the scene help to predict the {title_of(task)}?"
        answer = f"Network `{name}` sees the scene and has {error}. Network {rival} does not see "
        answer += f"it and has {error_text(rows.loc[blind], measure)}."
    else:
        rival = f"*{baseline}*"
        question = f"How well does a network predict the {title_of(task)}?"
        answer = f"Network `{name}` has {error}. Without a network, {rival} "
        answer += f"({NO_LEARNING[baseline]}) has {baseline_error}."

    choice = "validation error" if is_validated(table) else "test error (there is no validation)"
    meaning = measure.meaning
    ranges = [] if label else list_ranges(table)
    if len(ranges) > 1:
        meaning += f" Here it is the mean over the ranges {', '.join(ranges)}."
    mae = quantity.text(table.loc[("", name), "mae"])
    explained = [
        f"*{name}*: {NO_LEARNING[name]}" for name in list_methods(table) if name in NO_LEARNING
    ]
    return [
        f"{question} {answer} {meaning}",
        f"Verdict on `{name}` against {rival}: {_verdict_text(table, name, rival, measure)}.",
        f"The 95 % interval of the error of `{name}` is {interval_text(row, measure)}. `{name}` "
        f"has the least {choice} of the networks. Its mean absolute error of the "
        f"{quantity.shown_title} is {mae}.",
        f"Predictions without a network: {'; '.join(explained)}. The best of them is *{baseline}*, "
        f"with an error of {baseline_error}. Verdict on `{name}` against it: "
        f"{_verdict_text(table, name, baseline, measure)}.",
    ]


def _verdict_text(table: pd.DataFrame, name: str, rival: str, measure: Measure) -> str:
    """Return the verdict on a model against a rival, with the difference of their errors."""
    row = read_difference(table, name, rival.strip("`*"))
    difference = error_text(row, measure, measure.signed_form)
    bounds = interval_text(row, measure, measure.signed_form)
    return f"{row['verdict']} (difference {difference}, 95 % interval {bounds})"


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
    value = value_text(statistics.value_of(row), measure.form)
    if name in BASELINES or value == NONE:
        return value
    if page:
        return f"{value}\n{bounds_text(row, measure.form)}"
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
    value = statistics.value_of(row)
    if value is None:
        return NONE
    text = value_text(value, measure.signed_form)
    bounds = bounds_text(row, measure.signed_form)
    verdict = "" if pd.isna(row["verdict"]) else f" {row['verdict']}"
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
            "difference in nmse": f"{value_text(row['nmse'], '+.3f')} ({bounds_text(row, '+.3f')})",
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
            sections.append(Section(f"Scores: {part}", _table_of(rows, "split")))
    return sections


def _score_cells(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of the numbers of a part."""
    cells = {}
    for key, value in values.items():
        if not isinstance(value, dict):
            cells[key] = value_text(value, "" if isinstance(value, int) else ".3g")
    return cells


def write_definitions() -> str:
    """Return the DEFINITIONS in Markdown."""
    lines = "## Definitions\n\n"
    for word, meaning in DEFINITIONS.items():
        lines += fill(f"- {word}: {meaning}", 110, subsequent_indent="  ") + "\n"
    return lines
