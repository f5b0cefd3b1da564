"""Write errors, differences and claims on steering as tables of text.

With `page`, tables are those of index.html, which have an interval below its value. Values of all
ranges together have the range "".
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from pipeline.evaluate import statistics
from pipeline.evaluate.own_metrics import METRICS
from pipeline.evaluate.settings import BASELINES
from pipeline.report import paper
from pipeline.report.number_text import (
    NONE,
    bounds_text,
    difference_text,
    error_text,
    value_text,
)
from pipeline.report.section import Section, to_table
from pipeline.report.values import (
    Task,
    best_baseline,
    has_common_validation,
    is_validated,
    lead_label,
    list_ends,
    list_methods,
    list_ranges,
    measure_of,
    quantity_of,
    rank_models,
    read_difference,
    sees_scene,
    title_of,
)
from pipeline.train.quantity import NMSE, Measure, Quantity

# Share of the error that leads above which a drive is named.
LARGE_SHARE = 0.25


def results_table(values: pd.DataFrame, task: str, *, page: bool = False) -> Section:
    """Return the errors of models and baselines: those at each end, or nmse if there are no ends.

    If the models can judge a claim of the paper, the paper's errors stand beside them.
    """
    table = values.loc[task]
    chosen = rank_models(table)[0]
    with_paper = claims_table(values, task).table.size > 0
    notes = [f"✓ has the least {'validation' if is_validated(table) else 'test'} error."]
    if is_validated(table) and not has_common_validation(table):
        notes.append("Each validation error is over the frames that the model predicts itself.")
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
    return Section(f"Results: {title_of(task)}", to_table(rows, "model"), " ".join(notes))


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
    errors = Section(f"nmse by range: {title_of(task)}", to_table(rows, "model"), note)
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
    return Section(f"{title}: {title_of(task)}", to_table(rows, "models"))


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
    return Section("The paper's claims", to_table(rows, "the paper's claim"))


def models_table(tasks: Sequence[Task]) -> Section:
    """Return the inputs and settings of all models."""
    rows = {}
    for task in tasks:
        for name, content in task.models.items():
            rows[name] = _model_cells(content)
    return Section("Models", to_table(rows, "model"))


def _model_cells(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the cells of a model, from its metrics.json."""
    entry = content["entry"]
    cells = {"input": entry["input"]}
    if sees_scene(content):
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
