"""Build the text of table.md and of the page: first sentences, tables of models and baselines, and
of perception.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.params import SPLITS
from pipeline.evaluate.statistics import interval_text, shown_metrics
from pipeline.graphs.settings import Variant
from pipeline.report import paper
from pipeline.report.results import BASELINES, NO_LEARNING, USELESS, Group, Row
from pipeline.report.summary import Results, key

NONE = "–"  # cell without a value
DEFINITIONS = {
    "nmse": (
        "MSE / MSE of always predicting zero: 0 is perfect, 1 is useless; ± one standard deviation "
        "between seeds; in parentheses the 95 % interval for other roads and seeds (bootstrap; "
        "with one seed, for other roads only)."
    ),
    "MAE deg": "mean absolute error of the angle in degrees.",
    "drift": (
        "of the path by measured speed and predicted angles, m per 100 m (Figure 5 of the paper), "
        "on all frames that the model predicts."
    ),
    "edges": "directed kNN edges per frame after pruning.",
    "zero, train_mean": "baselines that are constants.",
    "persistence": "a baseline that repeats the last true angle, which no model gets.",
    "odometry": "a baseline that repeats the measured angle.",
    "regression": "a baseline: the best multiple of odometry on the training drives.",
    "differences": (
        "paired differences in nmse on the frames of the results, mean over the seeds, with their "
        "95 % intervals: below 0, the first is better. With one seed, the interval is of these "
        "networks only, which is too few to compare methods: add some to train.seeds. Fewer than "
        "ten drives are too few, too. The model with the least validation error (without "
        "validation: test error) is compared with the best baseline without learning and with the "
        "other models; models that differ in one setting, with each other."
    ),
}
CHOSEN = " ✓"
_PAPER = (
    "MSE of the models that have the settings of a network of the paper: in its Table 2, and here "
    "in rad², train and val on all frames of the model. The paper's unit cannot be rad² of this "
    "label (docs/paper.md): compare only order and ratio."
)
_CLAIMS = (
    "nmse and mean absolute error of both networks; MSE of the first relative to the second's, in "
    "the paper's Table 2 and here; the verdict is by the paired difference in nmse and its 95 % "
    "interval, as under Differences."
)
_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m, in Eigen's crop, the usual one of "
    "KITTI: means over frames. Only pixels with a predicted depth count; coverage is their share. "
    "flat ground: a level road below the camera, with the encoder's classes, on the same pixels; "
    "an encoder that does not beat it has learned no depth."
)
_MOTION = (
    "Motion since the previous frame, measured from images, compared with the recorded motion "
    "(oxts or a log) at or above labels.min_speed_mps. wheel: recorded angles; …-wheel: compared "
    "with these. nmse: of the steering angle from the last measurement."
)


class Table(NamedTuple):
    """A table of text cells with a title and a note; `rows`: heading → cell, in which headings may
    be missing.
    """

    title: str
    rows: Sequence[dict[str, str]]
    note: str = ""

    @property
    def heads(self) -> list[str]:
        """The headings that have a value in a row."""
        heads = dict.fromkeys(head for row in self.rows for head in row)
        return [head for head in heads if any(row.get(head, NONE) != NONE for row in self.rows)]

    @property
    def cells(self) -> list[list[str]]:
        return [[row.get(head, NONE) for head in self.heads] for row in self.rows]

    def markdown(self) -> str:
        """Return title, table and note as Markdown, with the first column aligned to the left,
        others to the right.
        """
        widths = [max(map(len, column)) for column in zip(self.heads, *self.cells, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        form = " | ".join([f"{{:<{widths[0]}}}", *(f"{{:>{width}}}" for width in widths[1:])])
        lines = [f"| {form.format(*row)} |" for row in (self.heads, rule, *self.cells)]
        return "\n\n".join(
            filter(None, [f"## {self.title}", "\n".join(lines), fill(self.note, 110)])
        )


def definitions() -> str:
    """Return the definitions of the tables' words as Markdown."""
    lines = [
        fill(f"- {word}: {meaning}", 110, subsequent_indent="  ")
        for word, meaning in DEFINITIONS.items()
    ]
    return "\n".join(["## Definitions", "", *lines])


def number(value: Any, form: str = "") -> str:
    """Return a value as text, NONE without one."""
    return NONE if value is None or pd.isna(value) else format(value, form)


def headline(groups: Sequence[Group], figures: Results) -> str:
    """Return one sentence on what the first group's best model shows; empty without a bend in the
    test drives.
    """
    if not groups:
        return ""
    group = groups[0]
    name = group.by_error[0]["model"]
    baseline = group.best_baseline
    error = figures[key(group.key, name)]["figure"]
    without = figures[key(group.key, baseline)]["figure"]
    difference = figures[key(group.key, name, minus=baseline)]
    if error is None or difference["figure"] is None:
        return ""
    found = f"{name} predicts the {group.title} with an nmse of {error:.3f}"
    return f"{found}; {baseline}, without learning, has {without:.3f} ({difference['verdict']})."


def sentences(groups: Sequence[Group], figures: Results, absent: Sequence[str] = ()) -> list[str]:
    """Return texts on the best model of the first group, on models that learned nothing, and on
    absent ones.
    """
    texts = []
    if groups:
        group = groups[0]
        best = group.by_error[0]
        name = best["model"]
        baseline = group.best_baseline
        errors = figures[key(group.key, name)]
        without = figures[key(group.key, baseline)]
        difference = figures[key(group.key, name, minus=baseline)]
        choice = "validation error" if group.validated else "test error (there is no validation)"
        count = len(np.unique(group.drive[np.isfinite(group.truth).any(axis=1)]))
        drives = "1 drive" if count == 1 else f"{count} drives"
        if difference["figure"] is not None:  # there is a bend in the test drives
            texts.append(
                f"On {drives} that it was not trained on, {name}, the model with the least "
                f"{choice}, predicts the "
                f"{'turn of the ' * any(group.labels.values())}{group.title} with a mean absolute "
                f"error of {errors['mae_deg']:.2f}° and an nmse of {errors['figure']:.3f} (95 % "
                f"interval: {interval_text(errors['interval'])}); nmse is the squared error "
                "relative to that of always driving straight ahead, so 0 is perfect and 1 is "
                f"useless. The best baseline without learning, {baseline} "
                f"({NO_LEARNING[baseline]}), has {without['mae_deg']:.2f}° and "
                f"{without['figure']:.3f}. Difference in nmse {difference['figure']:+.3f} "
                f"({interval_text(difference['interval'], '+.3f')}): {difference['verdict']}."
            )
            scene_alone = best["entry"]["spatial"] != "blind" and best["entry"]["motion"] == "none"
            if scene_alone and baseline in ("odometry", "regression"):
                texts.append(
                    f"The two answer different questions. {baseline.capitalize()} uses the car's "
                    "own motion, measured from consecutive images: to know the present angle, use "
                    f"that (steer measure). {name} gets only the structure of the scene in front: "
                    "the question is what it tells of the angle, as in the paper."
                )
    if useless := [line for group in groups for line in _useless(group, figures).values()]:
        texts.append(" ".join(useless))
    if absent:
        texts.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull "
            "--allow-missing train evaluate, then dvc repro --pull --allow-missing"
        )
    return texts


def _useless(group: Group, figures: Results) -> dict[str, str]:
    """Return model → a sentence, for each model of a group that has learned nothing."""
    return {
        row[
            "model"
        ]: f"{row['model']} learned nothing (test nmse above {USELESS}); its training drives have "
        f"{row['turning_frames']:,} turning frames (radius below 135 m)."
        for row in group.models
        if (figures[key(group.key, row["model"])]["figure"] or 0.0) > USELESS
    }


class SteeringTables(NamedTuple):
    """The tables of all groups that have rows."""

    results: list[Table]  # errors of models and baselines
    paper: list[Table]  # its claims and its Table 2
    details: list[Table]  # differences, and the models' inputs and settings


def steering_tables(groups: Sequence[Group], figures: Results) -> SteeringTables:
    """Return the tables of all groups. The paper's numbers are shown for networks whose claim can
    be judged.
    """
    results = [
        Table(f"Results: {group.title}", _results(group, figures), _frames(group, figures))
        for group in groups
    ]
    present = [group for group in groups if group.key == "angle-0"]
    claims = [claim for group in present for claim in _claims(group)]
    judged = {name for claim in claims for name in (claim.model, claim.rival)}
    published = [
        row for group in present for row in _as_published(group, figures) if row["model"] in judged
    ]
    paper_tables = [
        Table(
            "The paper's claims",
            [claim_cells(claim, "angle-0", figures) for claim in claims],
            _CLAIMS,
        ),
        Table("The paper's Table 2", published, _PAPER),
    ]
    details = [
        Table(f"Differences: {group.title}", _differences(group, figures)) for group in groups
    ]
    details.append(Table("Models", [_model(row) for group in groups for row in group.models]))
    return SteeringTables(
        *([table for table in part if table.rows] for part in (results, paper_tables, details))
    )


def _results(group: Group, figures: Results) -> list[dict[str, str]]:
    models = {row["model"]: row for row in group.models}
    useless = _useless(group, figures)
    chosen = group.by_error[0]["model"]
    rows = []
    for name in group.predicted:
        row = models.get(name, {})
        marks = CHOSEN if name == chosen else ""
        marks += " †" if row.get("untrained") else ""
        marks += " ‡" if name in useless else ""
        cells = {"model": f"*{name}*" if name in BASELINES else name + marks}
        for column, label in group.labels.items():
            errors = figures[key(group.key, name, label)]
            text = number(errors["figure"], ".3f")
            if row and errors["figure"] is not None:
                spread = (
                    f" ± {np.std(errors['seeds'], ddof=1):.3f}" if len(errors["seeds"]) > 1 else ""
                )
                text += f"{spread} ({interval_text(errors['interval'])})"
            cells[f"nmse {label}".strip()] = text
            for metric in shown_metrics():
                cells[f"{metric} {label}".strip()] = number(errors[metric], ".3f")
            if not label:
                cells["MAE deg"] = number(errors["mae_deg"], ".2f")
            if group.key == "angle-0":
                cells["drift"] = number(
                    row["test"][column]["drift_m_per_100m"] if row else None, ".1f"
                )
        cells["parameters"] = number(row.get("parameters"), ",d")
        cells["edges"] = number(row.get("edges_per_frame"), ",.0f")
        rows.append(cells)
    return rows


def _frames(group: Group, figures: Results) -> str:
    """Return a note on frames, on seeds that failed to train, and on models that have learned
    nothing.
    """
    known = np.isfinite(group.truth).sum(axis=0)
    frames = ", ".join(
        f"{label} {count:,}".strip()
        for label, count in zip(group.labels.values(), known, strict=True)
    )
    counts = {
        row["model"]: (len(row.get("untrained", ())), len(row["seeds"])) for row in group.models
    }
    stuck = [
        f"† {few} of {seeds} seeds of {model} failed to train. "
        for model, (few, seeds) in counts.items()
        if few
    ]
    useless = [f"‡ {line} " for line in _useless(group, figures).values()]
    chosen = f"✓ has the least {'validation' if group.validated else 'test'} error. "
    return "".join(
        [chosen, *stuck, *useless, f"Test frames that every model of the table predicts: {frames}."]
    )


def _differences(group: Group, figures: Results) -> list[dict[str, str]]:
    best, *others = [row["model"] for row in group.by_error]
    pairs = {(best, name): "" for name in (group.best_baseline, *others)}
    for pair in combinations(group.models, 2):
        # ours minus the paper's
        first, second = sorted(pair, key=lambda row: row["paper"] is not None)
        if len(changed := _changed(first, second)) == 1:
            pairs.pop((second["model"], first["model"]), None)
            pairs[first["model"], second["model"]] = f" ({changed[0]})"
    rows = []
    for (first, second), setting in pairs.items():
        cells = {"models": f"{first} − {second}{setting}"}
        for label in group.labels.values():
            cells[label or "nmse"] = difference_text(figures[key(group.key, first, label, second)])
        rows.append(cells)
    return rows


def difference_text(entry: Mapping[str, Any]) -> str:
    """Return a paired difference in nmse with its interval and verdict."""
    if entry["figure"] is None:
        return NONE
    return f"{entry['figure']:+.3f} ({interval_text(entry['interval'], '+.3f')}) {entry['verdict']}"


def _changed(*pair: Row) -> list[str]:
    """Return "setting: a → b" of each setting in which two models or their graph variants differ,
    if both have it.
    """
    first, second = (row["entry"] for row in pair)
    settings = [(key, first[key], second[key]) for key in first if key in second and key != "input"]
    if "blind" not in (first["spatial"], second["spatial"]):
        keys = Variant.model_fields.items()
        settings += [
            (key, *(row["variant"].get(key, field.default) for row in pair)) for key, field in keys
        ]
    return [f"{key}: {a} → {b}" for key, a, b in settings if a != b]


def _as_published(group: Group, figures: Results) -> list[dict[str, str]]:
    return [
        {
            "model": row["model"],
            "paper train": str(row["paper"].train_mse),
            "paper test": str(row["paper"].test_mse),
        }
        | {
            split: number(row[split] and row[split]["steering_rad"]["mse"], "#.3g")
            for split in ("train", "val")
        }
        | {"test": number(figures[key(group.key, row["model"])]["mse"], "#.3g")}
        for row in group.models
        if row["paper"]
    ]


def _claims(group: Group) -> list[paper.Claim]:
    """Return the claims whose two networks have the paper's settings, but for PointNet++'s
    width.
    """
    models = {row["model"]: row for row in group.models}

    def as_meant(name: str, claim: paper.Claim) -> bool:
        if name not in paper.PAPER:
            return len(_changed(models[claim.model], models[name])) == 1
        return (
            paper.find(name, models[name]["entry"] | {"width": 1.0}, models[name]["variant"])
            is not None
        )

    claims = []
    for claim in paper.CLAIMS:
        pair = claim.model, claim.rival
        if {*pair} <= models.keys() and all(as_meant(name, claim) for name in pair):
            claims.append(claim)
    return claims


def claim_cells(claim: paper.Claim, group: str, figures: Results) -> dict[str, str]:
    """Return a row about a claim, by the figures of its two networks in a group."""
    first = figures[key(group, claim.model)]
    second = figures[key(group, claim.rival)]
    difference = figures[key(group, claim.model, minus=claim.rival)]
    interval = interval_text(difference["interval"], "+.3f")
    ours = first["figure"]
    other = second["figure"]
    verdicts = {"better": "reversed" if claim.comparable else "confirmed", "worse": "reversed"}
    model, rival = paper.PAPER.get(claim.model), paper.PAPER.get(claim.rival)
    return {
        "the paper's claim": claim.text,
        "verdict": verdicts.get(difference["verdict"], str(difference["verdict"])),
        "networks": f"{claim.model}, {claim.rival}",
        "nmse": f"{number(ours, '.3f')}, {number(other, '.3f')}",
        "mean error, °": f"{number(first['mae_deg'], '.2f')}, {number(second['mae_deg'], '.2f')}",
        "MSE ratio: paper": number(
            model.test_mse / rival.test_mse if model and rival else None, ".2f"
        ),
        "here": number(ours / other if ours is not None and other else None, ".2f"),
        "difference in nmse": f"{number(difference['figure'], '+.3f')} ({interval})",
    }


def _model(row: Row) -> dict[str, str]:
    entry, unpruned = row["entry"], row["edges_per_frame_unpruned"]
    # of pyg, of ncp
    layer, cell = (f" ({entry[key]})" if key in entry else "" for key in ("layer", "cell"))
    names = ("semantics", "window", "equivariant", "motion")
    return {
        "model": row["model"],
        "input": entry["input"],
        "points": number(row["points_per_frame"], ",.0f"),
        "edges": number(unpruned, ",.0f"),
        "pruned": number(1 - row["edges_per_frame"] / unpruned if unpruned else None, ".0%"),
        "spatial": entry["spatial"] + layer,
        "temporal": entry["temporal"] + cell,
        **{name: number(entry.get(name)) for name in names},
    }


def perception_tables(scores: dict[str, Any]) -> list[Table]:
    """Return the tables of depth, classes and motion that have rows."""
    classes = [
        {
            "split": split,
            "frames": str(row["frames"]),
            "pixel accuracy": f"{row['pixel_accuracy']:.3f}",
            "mean IoU": f"{row['mean_iou']:.3f}",
            "classes": str(len(row["iou"])),
        }
        for split in SPLITS
        if (row := scores[split]["classes"])
    ]
    motion = [
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
        for (kind, splits), split in product(scores["motion"].items(), SPLITS)
        if (row := splits[split])
    ]
    tables = [
        Table("Depth", _depth(scores), _DEPTH),
        Table("Classes", classes, "Over the classes that occur in the ground truth."),
        Table("Motion", motion, _MOTION),
    ]
    return [table for table in tables if table.rows]


def _depth(scores: dict[str, Any]) -> list[dict[str, str]]:
    sources = {"encoder": "depth", "flat ground": "ground_plane"}
    rows = []
    for split, truth in product(SPLITS, ("lidar", "dense")):
        if depth := scores[split][f"depth_{truth}"]:
            row = {"split": split, "truth": truth, "frames": str(depth["frames"])}
            row["coverage"] = f"{depth['coverage']:.1%}"
            for head, source in sources.items():
                errors = scores[split][f"{source}_{truth}"]
                row[head] = (
                    "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(errors)
                    if errors
                    else NONE
                )
            rows.append(row)
    return rows
