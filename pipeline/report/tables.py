"""Build the text of table.md and of the page: first sentences, tables of models and baselines, and of perception."""

from collections.abc import Sequence
from itertools import combinations, product
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pipeline.base.params import SPLITS
from pipeline.evaluate.statistics import interval_text
from pipeline.graphs.settings import Variant
from pipeline.report import paper
from pipeline.report.results import BASELINES, NO_LEARNING, USELESS, Difference, Group, Row

NONE = "–"  # cell without a value
_RESULTS = (
    "nmse = MSE / MSE of always predicting zero: 0 is perfect, 1 is useless; ± one standard deviation between seeds; "
    "in parentheses the 95 % interval for other roads and seeds (bootstrap; with one seed, for other roads only). "
    "drift: of the path by measured speed and predicted angles, m per 100 m (Figure 5 of the paper), on all frames "
    "that the model predicts. edges: directed kNN edges per frame after pruning. Baselines: zero and train_mean are "
    "constants; persistence repeats the last true angle, which no model gets; odometry repeats the measured angle; "
    "regression is its best multiple on the training drives."
)
_PAPER = (
    "MSE of the models that have the settings of a network of the paper: in its Table 2, and here in rad², train and "
    "val on all frames of the model. The paper's unit cannot be rad² of this label (docs/paper.md): compare only order "
    "and ratio."
)
_CLAIMS = (
    "nmse and mean absolute error of both networks; MSE of the first relative to the second's, in the paper's Table 2 "
    "and here; the verdict is by the paired difference in nmse and its 95 % interval, as under Differences."
)
_DIFFERENCES = (
    "Paired difference in nmse on the frames of the results, mean over the seeds, with its 95 % interval: below 0, the "
    "first is better. With one seed, the interval is of these networks only; fewer than ten drives are too few to "
    "compare methods. The model with the least validation error (without validation: test error) is compared with the "
    "best baseline without learning and with the other models; models that differ in one setting, with each other."
)
_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m, in Eigen's crop, the usual one of KITTI: means over "
    "frames. Only pixels with a predicted depth count; coverage is their share. flat ground: a level road below the "
    "camera, with the encoder's classes, on the same pixels; an encoder that does not beat it has learned no depth."
)
_MOTION = (
    "Motion since the previous frame, measured from images, compared with the recorded motion (oxts or a log) at or "
    "above labels.min_speed_mps. wheel: recorded angles; …-wheel: compared with these. nmse: of the steering angle "
    "from the last measurement."
)


class Table(NamedTuple):
    """A table of text cells with a title and a note; `rows`: heading → cell, in which headings may be missing."""

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
        """Return title, table and note as Markdown, with the first column aligned to the left, others to the right."""
        widths = [max(map(len, column)) for column in zip(self.heads, *self.cells, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        form = " | ".join([f"{{:<{widths[0]}}}", *(f"{{:>{width}}}" for width in widths[1:])])
        lines = [f"| {form.format(*row)} |" for row in (self.heads, rule, *self.cells)]
        return "\n\n".join(filter(None, [f"## {self.title}", "\n".join(lines), fill(self.note, 110)]))


def number(value: Any, form: str = "") -> str:
    """Return a value as text, NONE without one."""
    return NONE if value is None or pd.isna(value) else format(value, form)


def sentences(groups: Sequence[Group], absent: Sequence[str] = ()) -> list[str]:
    """Return texts on the best model of the first group, on models that learned nothing, and on absent ones."""
    texts = []
    if groups:
        group, best = groups[0], groups[0].by_error[0]
        name, baseline = best["model"], group.best_baseline
        (nmse, interval), (difference, bounds, verdict) = group.nmse(name), group.difference(name, baseline)
        choice = "validation error" if group.validated else "test error (there is no validation)"
        count = len(np.unique(group.drive[np.isfinite(group.truth).any(axis=1)]))
        drives = "1 drive" if count == 1 else f"{count} drives"
        if difference is not None:  # there is a bend in the test drives
            texts.append(
                f"On {drives} that it was not trained on, {name}, the model with the least {choice}, predicts "
                f"the {'turn of the ' * any(group.labels.values())}{group.title} with a mean absolute error of "
                f"{group.mae_deg(name):.2f}° and an nmse of {nmse:.3f} (95 % interval: {interval_text(interval)}); "
                "nmse is the squared error relative to that of always driving straight ahead, so 0 is perfect and 1 "
                f"is useless. The best baseline without learning, {baseline} ({NO_LEARNING[baseline]}), has "
                f"{group.mae_deg(baseline):.2f}° and {group.nmse(baseline)[0]:.3f}. Difference in nmse "
                f"{difference:+.3f} ({interval_text(bounds, '+.3f')}): {verdict}."
            )
            scene_alone = best["entry"]["spatial"] != "blind" and best["entry"]["motion"] == "none"
            if scene_alone and baseline in ("odometry", "regression"):
                texts.append(
                    f"The two answer different questions. {baseline.capitalize()} uses the car's own motion, measured "
                    f"from consecutive images: to know the present angle, use that (steer measure). {name} gets only "
                    "the structure of the scene in front: the question is what it tells of the angle, as in the paper."
                )
    if useless := [line for group in groups for line in _useless(group).values()]:
        texts.append(" ".join(useless))
    if absent:
        texts.append(
            f"No result here: {', '.join(absent)}. To fetch those of another machine: dvc pull --allow-missing train "
            "evaluate, then dvc repro --pull --allow-missing"
        )
    return texts


def _useless(group: Group) -> dict[str, str]:
    """Return model → a sentence, for each model of a group that has learned nothing."""
    return {
        row["model"]: f"{row['model']} learned nothing (test nmse above {USELESS}); its training drives have "
        f"{row['turning_frames']:,} turning frames (radius below 135 m)."
        for row in group.models
        if (group.nmse(row["model"])[0] or 0.0) > USELESS
    }


def steering_tables(groups: Sequence[Group]) -> list[Table]:
    """Return the tables of all groups: first the errors of each group, then details."""
    notes = [_frames(group) + _RESULTS * (group is groups[0]) for group in groups]
    present = [group for group in groups if group.key == "angle-0"]
    tables = [
        *(Table(f"Results: {group.title}", _results(group), note) for group, note in zip(groups, notes, strict=True)),
        Table("The paper's claims", [row for group in present for row in _claims(group)], _CLAIMS),
        *(Table(f"Differences: {group.title}", _differences(group), _DIFFERENCES) for group in groups),
        Table("The paper's Table 2", [row for group in present for row in _as_published(group)], _PAPER),
        Table("Models", [_model(row) for group in groups for row in group.models]),
    ]
    return [table for table in tables if table.rows]


def _results(group: Group) -> list[dict[str, str]]:
    models, useless, rows = {row["model"]: row for row in group.models}, _useless(group), []
    for name in group.predicted:
        row = models.get(name, {})
        marks = " †" * bool(row.get("untrained")) + " ‡" * (name in useless)
        cells = {"model": f"*{name}*" if name in BASELINES else name + marks}
        for column, label in group.labels.items():
            nmse, bounds = group.nmse(name, column=column)
            text = number(nmse, ".3f")
            if row and nmse is not None:
                by_seed = group.scores(name, column)["by_seed"]
                spread = f" ± {np.std(by_seed, ddof=1):.3f}" if len(by_seed) > 1 else ""
                text += f"{spread} ({interval_text(bounds)})"
            cells[f"nmse {label}".strip()] = text
            if not label:
                cells["MAE deg"] = number(group.mae_deg(name), ".2f")
            if group.key == "angle-0":
                cells["drift"] = number(row["test"][column]["drift_m_per_100m"] if row else None, ".1f")
        cells["parameters"] = number(row.get("parameters"), ",d")
        cells["edges"] = number(row.get("edges_per_frame"), ",.0f")
        rows.append(cells)
    return rows


def _frames(group: Group) -> str:
    """Return a note on frames, on seeds that failed to train, and on models that have learned nothing."""
    known = np.isfinite(group.truth).sum(axis=0)
    frames = ", ".join(f"{label} {count:,}".strip() for label, count in zip(group.labels.values(), known, strict=True))
    counts = {row["model"]: (len(row.get("untrained", ())), len(row["seeds"])) for row in group.models}
    stuck = [f"† {few} of {seeds} seeds of {model} failed to train. " for model, (few, seeds) in counts.items() if few]
    useless = [f"‡ {line} " for line in _useless(group).values()]
    return f"{''.join(stuck + useless)}Test frames that every model of the table predicts: {frames}. "


def _differences(group: Group) -> list[dict[str, str]]:
    best, *others = [row["model"] for row in group.by_error]
    pairs = {(best, name): "" for name in (group.best_baseline, *others)}
    for pair in combinations(group.models, 2):
        first, second = sorted(pair, key=lambda row: row["paper"] is not None)  # ours minus the paper's
        if len(changed := _changed(first, second)) == 1:
            pairs.pop((second["model"], first["model"]), None)
            pairs[first["model"], second["model"]] = f" ({changed[0]})"
    rows = []
    for (first, second), setting in pairs.items():
        cells = {"models": f"{first} − {second}{setting}"}
        for column, label in group.labels.items():
            nmse, bounds, verdict = group.difference(first, second, column)
            text = NONE if nmse is None else f"{nmse:+.3f} ({interval_text(bounds, '+.3f')}) {verdict}"
            cells[label or "nmse"] = text
        rows.append(cells)
    return rows


def _changed(*pair: Row) -> list[str]:
    """Return "setting: a → b" of each setting in which two models or their graph variants differ, if both have it."""
    first, second = (row["entry"] for row in pair)
    settings = [(key, first[key], second[key]) for key in first if key in second and key != "input"]
    if "blind" not in (first["spatial"], second["spatial"]):
        keys = Variant.model_fields.items()
        settings += [(key, *(row["variant"].get(key, field.default) for row in pair)) for key, field in keys]
    return [f"{key}: {a} → {b}" for key, a, b in settings if a != b]


def _as_published(group: Group) -> list[dict[str, str]]:
    return [
        {"model": row["model"], "paper train": str(row["paper"].train_mse), "paper test": str(row["paper"].test_mse)}
        | {split: number(row[split] and row[split]["steering_rad"]["mse"], "#.3g") for split in ("train", "val")}
        | {"test": number(group.scores(row["model"], "steering_rad")["mse"], "#.3g")}
        for row in group.models
        if row["paper"]
    ]


def _claims(group: Group) -> list[dict[str, str]]:
    """Return a row per claim whose two networks have the paper's settings, but for PointNet++'s width."""
    models, rows = {row["model"]: row for row in group.models}, []

    def as_meant(name: str, claim: paper.Claim) -> bool:
        if name not in paper.PAPER:
            return len(_changed(models[claim.model], models[name])) == 1
        return paper.find(name, models[name]["entry"] | {"width": 1.0}, models[name]["variant"]) is not None

    for claim in paper.CLAIMS:
        pair = claim.model, claim.rival
        if {*pair} <= models.keys() and all(as_meant(name, claim) for name in pair):
            errors = [(group.nmse(name)[0], group.mae_deg(name)) for name in pair]
            rows.append(claim_cells(claim, errors, group.difference(*pair)))
    return rows


def claim_cells(claim: paper.Claim, errors: Sequence[tuple[Any, Any]], difference: Difference) -> dict[str, str]:
    """Return a row about a claim for the nmse and mean error in degrees of its two networks, None if unknown."""
    ((ours, ours_deg), (other, other_deg)), (nmse, bounds, outcome) = errors, difference
    verdicts = {"better": "reversed" if claim.comparable else "confirmed", "worse": "reversed"}
    model, rival = paper.PAPER.get(claim.model), paper.PAPER.get(claim.rival)
    return {
        "the paper's claim": claim.text,
        "verdict": verdicts.get(outcome, outcome),
        "networks": f"{claim.model}, {claim.rival}",
        "nmse": f"{number(ours, '.3f')}, {number(other, '.3f')}",
        "mean error, °": f"{number(ours_deg, '.2f')}, {number(other_deg, '.2f')}",
        "MSE ratio: paper": number(model.test_mse / rival.test_mse if model and rival else None, ".2f"),
        "here": number(ours / other if ours is not None and other else None, ".2f"),
        "difference in nmse": f"{number(nmse, '+.3f')} ({interval_text(bounds, '+.3f')})",
    }


def _model(row: Row) -> dict[str, str]:
    entry, unpruned = row["entry"], row["edges_per_frame_unpruned"]
    layer, cell = (f" ({entry[key]})" if key in entry else "" for key in ("layer", "cell"))  # of pyg, of ncp
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
                row[head] = "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(errors) if errors else NONE
            rows.append(row)
    return rows
