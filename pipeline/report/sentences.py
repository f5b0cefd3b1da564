"""Write the verdict of the results, and its reasons for doubt, as sentences."""

import math
from collections.abc import Sequence

import pandas as pd

from pipeline.evaluate import statistics
from pipeline.evaluate.settings import BASELINES, NO_LEARNING
from pipeline.report.number_text import bounds_text, difference_text, with_unit
from pipeline.report.values import (
    Task,
    best_baseline,
    is_validated,
    lead_errors,
    lead_label,
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
from pipeline.train.quantity import Measure

# Number of turning frames in the training drives below which models cannot be told apart.
LEAST_TURNING = 20


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


def unmeasured_drives(tasks: Sequence[Task]) -> list[str]:
    """Return doubts: one if nothing is measured in some of the test drives, otherwise none."""
    drives: set[str] = set()
    for task in tasks:
        drives.update(task.predictions.unmeasured)
    if not drives:
        return []
    names = ", ".join(sorted(drives))
    return [f"no motion is measured in {names}, where odometry and regression count as 0"]


def few_drives(values: pd.DataFrame) -> list[str]:
    """Return doubts: one if the test drives are too few for a verdict, otherwise none."""
    if statistics.TOO_FEW_DRIVES not in values["verdict"].to_numpy():
        return []
    least = f"at least {statistics.LEAST_DRIVES} are needed, and a long drive counts as several"
    return [f"the test drives are too few ({least}), so their errors mean nothing for other roads"]
