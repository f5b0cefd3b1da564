"""Build the text of table.md and of the page from the values of results.json."""

from collections.abc import Mapping, Sequence
from itertools import product
from textwrap import fill
from typing import Any, NamedTuple

import pandas as pd

from pipeline.base.console import split_doubts
from pipeline.base.params import SPLITS
from pipeline.evaluate.statistics import interval_text, nmse_text, shown_metrics
from pipeline.report import paper
from pipeline.report.results import NO_LEARNING, Group, Row
from pipeline.report.summary import Comparison

# Text of a cell without a value.
NONE = "–"
# nmse on the test drives above which a model has learned nothing.
USELESS = 0.95
# Number of turning frames in the training drives below which models cannot be told apart.
LEAST_TURNING = 20
# Words that the tables use → their meanings.
DEFINITIONS = {
    "nmse": (
        "MSE / MSE of always predicting zero: 0 is perfect, 1 is useless; ± one standard deviation "
        "between seeds; in parentheses the 95 % interval for other roads and seeds (bootstrap; "
        "with one seed, for other roads only)."
    ),
    "MAE": "mean absolute error, with its unit.",
    "drift": (
        "of the path by measured speed and predicted angles, m per 100 m (Figure 5 of the paper), "
        "on all frames that the model predicts."
    ),
    "edges": "directed kNN edges per frame after pruning.",
    "paper": "MSE in the paper's Table 2. Its unit cannot be rad² of this label (docs/paper.md).",
    "zero, train_mean": "baselines that are constants.",
    "persistence": "a baseline that repeats the last true value, which no model gets.",
    "odometry": (
        "a baseline that repeats the measured value: to know the present angle, use that (steer "
        "measure). A model without motion gets only the scene, and the question is what it tells."
    ),
    "regression": "a baseline: the best multiple of odometry on the training drives.",
    "differences": (
        "paired differences in nmse on the frames of the results, mean over the seeds, with their "
        "95 % intervals: below 0, the first is better. With one seed, the interval is of these "
        "networks only, which is too few to compare methods: add some to train.seeds. Fewer than "
        "ten drives are too few, too. The model with the least validation error (without "
        "validation: test error) is compared with the best baseline without learning and with the "
        "other models."
    ),
    "claims": (
        "nmse and mean absolute error of both networks; MSE of the first relative to the second's, "
        "in the paper's Table 2 and here; the verdict is by the paired difference in nmse."
    ),
}
# Note of the table of depth.
_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m, in Eigen's crop, the usual one of "
    "KITTI: means over frames. Only pixels with a predicted depth count; coverage is their share. "
    "flat ground: a level road below the camera, with the encoder's classes, on the same pixels; "
    "an encoder that does not beat it has learned no depth."
)
# Note of the table of motion.
_MOTION = (
    "Motion since the previous frame, measured from images, compared with the recorded motion "
    "(oxts or a log) at or above labels.min_speed_mps. wheel: recorded angles; …-wheel: compared "
    "with these. nmse: of the steering angle from the last measurement."
)


class Table(NamedTuple):
    """A table of text cells with a title and a note."""

    title: str
    rows: Sequence[Mapping[str, str]]  # each maps headings to cells, and may lack some headings
    note: str = ""

    @property
    def heads(self) -> list[str]:
        """The headings that have a value in at least one row."""
        heads: dict[str, bool] = {}
        for row in self.rows:
            for head, cell in row.items():
                heads[head] = heads.get(head, False) or cell != NONE
        return [head for head, has_value in heads.items() if has_value]

    @property
    def cells(self) -> list[list[str]]:
        """The cells of each row, which are NONE without a value."""
        heads = self.heads
        rows = []
        for row in self.rows:
            rows.append([row.get(head, NONE) for head in heads])
        return rows

    def markdown(self) -> str:
        """Return the table in Markdown, with the first column left- and others right-aligned."""
        lines = [self.heads, *self.cells]
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

    def section(self) -> str:
        """Return title, table and note in Markdown."""
        note = f"\n\n{fill(self.note, 110)}" if self.note else ""
        return f"## {self.title}\n\n{self.markdown()}{note}"


def number(value: Any, form: str = "") -> str:
    """Return a number as text, or NONE for None and NaN."""
    return NONE if value is None or pd.isna(value) else format(value, form)


# Sentences


def sentences(comparisons: Sequence[Comparison], absent: Sequence[str] = ()) -> list[str]:
    """Return sentences on the results, the headline first.

    `absent` are models without results on this machine, which the last sentence names.
    """
    texts = _finding(comparisons[0]) if comparisons else []
    for comparison in comparisons:
        texts += useless_models(comparison).values()
    if absent:
        texts.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull "
            "--allow-missing train evaluate, then dvc repro --pull --allow-missing"
        )
    return texts


def _finding(comparison: Comparison) -> list[str]:
    """Return sentences on the best model, or none if the test drives have no bend."""
    name = comparison.by_error[0]
    baseline = comparison.best_baseline
    errors = comparison.entry(name)
    baseline_errors = comparison.entry(baseline)
    difference = comparison.difference(name, baseline)
    if difference["value"] is None:
        return []

    # The headline compares with a network that lacks the scene, if there is one.
    rival = comparison.without_scene
    headline = f"Model {name} predicts the {comparison.title} with an error (nmse) of "
    headline += f"{errors['value']:.3f}, where 0 is perfect and 1 is useless. "
    if rival and comparison.gets_scene(name):
        headline += f"Without the scene, model {rival} has {comparison.entry(rival)['value']:.3f}. "
        verdict = comparison.difference(name, rival)["verdict"]
    else:
        headline += f"{baseline.capitalize()}, without a network, has "
        headline += f"{baseline_errors['value']:.3f}. "
        verdict = difference["verdict"]
    headline += f"Verdict on the difference: {verdict}."

    text = comparison.quantity.text
    choice = "validation error" if comparison.validated else "test error (there is no validation)"
    count = errors["drives"]
    drives = "1 drive" if count == 1 else f"{count} drives"
    bounds = interval_text(difference["interval"], "+.3f")
    return [
        headline,
        f"These are errors on {drives} that it was not trained on. nmse is the squared error "
        f"relative to that of always predicting zero. {name} is the model with the least "
        f"{choice}: its mean absolute error of the {comparison.quantity.shown_title} is "
        f"{text(errors['mae'])}, and the "
        f"95 % interval of its nmse is {interval_text(errors['interval'])}.",
        f"The best baseline without a network that does not get the truth is {baseline}, "
        f"{NO_LEARNING[baseline]}. Its nmse is {baseline_errors['value']:.3f}, and its mean "
        f"absolute error {text(baseline_errors['mae'])}. {name} differs from it by "
        f"{difference['value']:+.3f} in nmse ({bounds}): {difference['verdict']}.",
    ]


def useless_models(comparison: Comparison) -> dict[str, str]:
    """Return model → a sentence, for each model that has learned nothing."""
    texts = {}
    for name in comparison.models:
        entry = comparison.entry(name)
        if (entry["value"] or 0.0) > USELESS:
            texts[name] = (
                f"{name} learned nothing (test nmse above {USELESS}); its training drives have "
                f"{entry['turning_frames']:,} turning frames (radius below 135 m)."
            )
    return texts


def few_turns(comparisons: Sequence[Comparison]) -> list[str]:
    """Return a list of a doubt if the training drives have too few bends, or an empty list."""
    counts = []
    for comparison in comparisons:
        counts += [comparison.entry(name)["turning_frames"] for name in comparison.models]
    if not counts or min(counts) >= LEAST_TURNING:
        return []
    text = f"{min(counts)} frames of the training drives turn (radius below 135 m)"
    return [f"{text}, too few to tell models apart"]


# Tables of steering


def results_table(comparison: Comparison) -> Table:
    """Return the table of the errors of models and baselines.

    If the models can judge a claim of the paper, it has the paper's errors, too.
    """
    useless = useless_models(comparison)
    with_paper = bool(claims_table(comparison).rows)
    chosen = comparison.by_error[0]
    notes = [f"✓ has the least {'validation' if comparison.validated else 'test'} error."]
    rows = []
    for name in (*comparison.models, *comparison.baselines):
        facts = comparison.entry(name)
        marks = " ✓" if name == chosen else ""
        stuck = len(facts.get("untrained", []))
        if stuck:
            marks += " †"
            notes.append(f"† {stuck} of {len(facts['seeds'])} seeds of {name} failed to train.")
        if name in useless:
            marks += " ‡"
            notes.append(f"‡ {useless[name]}")

        cells = {"model": name + marks if name in comparison.models else f"*{name}*"}
        if with_paper:
            cells |= {"paper: train MSE": NONE, "paper: test MSE": NONE}
            if facts.get("paper"):
                cells["paper: train MSE"] = f"{paper.PAPER[name].train_mse:.3f}"
                cells["paper: test MSE"] = f"{paper.PAPER[name].test_mse:.3f}"
            cells["MSE, rad²"] = number(facts["mse"], "#.3g")
        for label in comparison.labels:
            cells |= _error_cells(comparison, name, label)
        cells["drift"] = number(facts.get("drift"), ".1f")
        cells["parameters"] = number(facts.get("parameters"), ",d")
        cells["edges"] = number(facts.get("edges"), ",.0f")
        rows.append(cells)
    frames = [
        f"{label} {comparison.entry(chosen, label)['frames']:,}".strip()
        for label in comparison.labels
    ]
    notes.append(f"Test frames that every model of the table predicts: {', '.join(frames)}.")
    return Table(f"Results: {comparison.title}", rows, " ".join(notes))


def _error_cells(comparison: Comparison, name: str, label: str) -> dict[str, str]:
    """Return the cells of the errors of a model or baseline in a range, named by its `label`.

    The label of a quantity without ranges is empty.
    """
    entry = comparison.entry(name, label)
    quantity = comparison.quantity
    text = number(entry["value"], ".3f")
    if name in comparison.models and entry["value"] is not None:
        text = nmse_text(entry["value"], entry["seeds"], entry["interval"])
    cells = {f"nmse {label}".strip(): text}
    for metric in shown_metrics():
        cells[f"{metric} {label}".strip()] = number(entry.get(metric), ".3f")
    if not label:
        cells[f"MAE {quantity.shown_unit}"] = number(entry["mae"], quantity.shown_format)
    return cells


def differences_table(comparison: Comparison) -> Table:
    """Return the table of differences of the best model from the best baseline and other models."""
    best, *others = comparison.by_error
    rows = []
    for rival in (comparison.best_baseline, *others):
        cells = {"models": f"{best} − {rival}"}
        for label in comparison.labels:
            cells[label or "nmse"] = difference_text(comparison.difference(best, rival, label))
        rows.append(cells)
    return Table(f"Differences: {comparison.title}", rows)


def difference_text(entry: Mapping[str, Any]) -> str:
    """Return the text of a paired difference in nmse, with its interval and verdict."""
    if entry["value"] is None:
        return NONE
    bounds = interval_text(entry["interval"], "+.3f")
    return f"{entry['value']:+.3f} ({bounds}) {entry['verdict']}"


def claims_table(comparison: Comparison) -> Table:
    """Return the table of the paper's claims that the group's models can judge, with verdicts."""
    rows = []
    for claim in paper.CLAIMS:
        difference = comparison.difference(claim.model, claim.rival)
        if "claim" in difference:
            rows.append(_claim_cells(claim, comparison, difference))
    return Table("The paper's claims", rows)


def _claim_cells(
    claim: paper.Claim, comparison: Comparison, difference: Mapping[str, Any]
) -> dict[str, str]:
    first = comparison.entry(claim.model)
    second = comparison.entry(claim.rival)
    ratio = first["value"] / second["value"] if second["value"] else None
    published = None
    if claim.model in paper.PAPER and claim.rival in paper.PAPER:
        published = paper.PAPER[claim.model].test_mse / paper.PAPER[claim.rival].test_mse
    # A claim that both errors are equally large is refuted by a difference of either sign.
    verdicts = {"better": "reversed" if claim.comparable else "confirmed", "worse": "reversed"}
    bounds = interval_text(difference["interval"], "+.3f")
    form = comparison.quantity.shown_format
    return {
        "the paper's claim": claim.text,
        "verdict": verdicts.get(difference["verdict"], difference["verdict"]),
        "networks": f"{claim.model}, {claim.rival}",
        "nmse": f"{number(first['value'], '.3f')}, {number(second['value'], '.3f')}",
        "mean error, °": f"{number(first['mae'], form)}, {number(second['mae'], form)}",
        "MSE ratio: paper": number(published, ".2f"),
        "here": number(ratio, ".2f"),
        "difference in nmse": f"{number(difference['value'], '+.3f')} ({bounds})",
    }


def steering_tables(
    comparisons: Sequence[Comparison], groups: Sequence[Group]
) -> tuple[list[Table], list[Table]]:
    """Return the tables of results and claims, and the tables of details, as two lists."""
    results = [results_table(comparison) for comparison in comparisons]
    results += [claims_table(comparison) for comparison in comparisons]
    details = [differences_table(comparison) for comparison in comparisons]
    details.append(models_table(groups))
    with_rows = [table for table in results if table.rows]
    return with_rows, [table for table in details if table.rows]


def models_table(groups: Sequence[Group]) -> Table:
    """Return the table of the inputs and settings of all models."""
    rows = [_model_cells(name, row) for group in groups for name, row in group.models.items()]
    return Table("Models", rows)


def _model_cells(name: str, row: Row) -> dict[str, str]:
    entry = row["entry"]
    unpruned = row["edges_per_frame_unpruned"]
    pruned = 1 - row["edges_per_frame"] / unpruned if unpruned else None
    spatial = f"{entry['spatial']} ({entry['layer']})" if "layer" in entry else entry["spatial"]
    temporal = f"{entry['temporal']} ({entry['cell']})" if "cell" in entry else entry["temporal"]
    cells = {
        "model": name,
        "input": entry["input"],
        "points": number(row["points_per_frame"], ",.0f"),
        "edges": number(unpruned, ",.0f"),
        "pruned": number(pruned, ".0%"),
        "spatial": spatial,
        "temporal": temporal,
    }
    for setting in ("semantics", "window", "equivariant", "motion"):
        cells[setting] = number(entry.get(setting))
    return cells


# Tables of perception


def perception_tables(scores: Mapping[str, Any]) -> list[Table]:
    """Return the tables of depth, classes and motion, without those that have no rows."""
    if not scores:
        return []
    classes = []
    for split in SPLITS:
        row = scores[split]["classes"]
        if row:
            classes.append(
                {
                    "split": split,
                    "frames": str(row["frames"]),
                    "pixel accuracy": f"{row['pixel_accuracy']:.3f}",
                    "mean IoU": f"{row['mean_iou']:.3f}",
                    "classes": str(len(row["iou"])),
                }
            )
    motion = []
    for (kind, splits), split in product(scores["motion"].items(), SPLITS):
        row = splits[split]
        if row:
            motion.append(
                {
                    "motion": kind,
                    "split": split,
                    "drives": str(row["drives"]),
                    "frames": str(row["frames"]),
                    "measured": f"{row['valid']:.1%}",
                    "compared": str(row["judged"]),
                    "yaw rate RMSE deg/s": number(row["yaw_rmse_degps"], ".3f"),
                    "median": number(row["yaw_median_degps"], ".3f"),
                    "speed ratio": number(row["speed_ratio"], ".3f"),
                    "steering nmse": number(row["nmse"], ".4f"),
                }
            )
    tables = [
        Table("Depth", _depth_rows(scores), _DEPTH),
        Table("Classes", classes, "Over the classes that occur in the ground truth."),
        Table("Motion", motion, _MOTION),
    ]
    return [table for table in tables if table.rows]


def _depth_rows(scores: Mapping[str, Any]) -> list[dict[str, str]]:
    rows = []
    for split, truth in product(SPLITS, ("lidar", "dense")):
        depth = scores[split][f"depth_{truth}"]
        if not depth:
            continue
        row = {
            "split": split,
            "truth": truth,
            "frames": str(depth["frames"]),
            "coverage": f"{depth['coverage']:.1%}",
        }
        for head, source in {"encoder": "depth", "flat ground": "ground_plane"}.items():
            errors = scores[split][f"{source}_{truth}"]
            if errors:
                row[head] = "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(errors)
        rows.append(row)
    return rows


def recorded_motion(scores: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return notes and doubts about recorded motion, as two lists."""
    return split_doubts([facts["line"] for facts in scores.get("recorded", {}).values()])


def definitions() -> str:
    """Return the DEFINITIONS in Markdown."""
    text = "## Definitions\n\n"
    for word, meaning in DEFINITIONS.items():
        text += fill(f"- {word}: {meaning}", 110, subsequent_indent="  ") + "\n"
    return text
