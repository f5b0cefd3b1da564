"""Build the tables of models and baselines, and of perception, as text, for table.md and for the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.params import SPLITS
from pipeline.evaluate.errors import interval, interval_text
from pipeline.report.results import Group, Row
from pipeline.settings.evaluate import Evaluate

NONE = "–"  # cell without a value
_WIDTH = 110  # characters per line of a note
_RESULTS = (
    "nmse = MSE / MSE of always predicting zero: 0 is perfect, 1 is useless; ± one standard deviation between seeds; "
    "in parentheses the 95 % interval for other roads (block bootstrap), given these networks. no onsets: without the "
    "frames around the onset of a turn. drift: of a path of measured speed and predicted angles, in m per 100 m "
    "(Figure 5 of the paper). edges: directed kNN edges per frame after pruning, as in the paper. Baselines: zero and "
    "train_mean are constants; persistence repeats the last true angle, which no model gets; odometry repeats the "
    "present measured motion; regression multiplies it by its regression coefficient on the training drives."
)
_PAPER = (
    "MSE in rad². paper: its Table 2, for models with the settings of one of its networks. Its unit cannot be rad² of "
    "this label (docs/paper.md): compare order and ratio only."
)
_UNCERTAINTY = (
    "NLL: mean negative log-likelihood in nats under a normal distribution with the predicted σ, which is scaled on "
    "the validation drives; constant σ: the same with the best single σ for these frames. within σ: share of the truth "
    "that differs from the prediction by at most σ. in 95 % interval: by at most the multiple of σ that covers 95 % of "
    "the validation errors. certain half: mean error of the frames with the smaller σ over that of all."
)
_DIFFERENCES = (
    "nmse of the best model minus that of another on the same frames, mean over the seeds, with its 95 % interval: "
    "below 0, the best is better."
)
_DEPTH = (
    "Each depth as abs rel, RMSE in metres, δ1, from 1 to 80 m: means over frames. Only pixels with a predicted depth "
    "count; coverage is their share. flat ground: a level road below the camera, with the encoder's classes, on the "
    "same pixels; an encoder that does not beat it has learned no depth. Eigen: the usual crop of KITTI."
)
_CLASSES = "Over the classes that occur in the ground truth."
_MOTION = (
    "Motion since the previous frame, measured from images, compared with oxts at or above labels.min_speed_mps. "
    "wheel: recorded angles; …-wheel: compared with these. nmse: of the steering angle from the last measurement."
)


@dataclass(frozen=True)
class Table:
    """A table of text cells with a title and a note; `rows`: heading → cell, in which headings may be missing."""

    title: str
    rows: Sequence[dict[str, str]]
    note: str = ""

    @property
    def heads(self) -> list[str]:
        return [*dict.fromkeys(head for row in self.rows for head in row)]

    @property
    def cells(self) -> list[list[str]]:
        return [[row.get(head, NONE) for head in self.heads] for row in self.rows]

    def markdown(self) -> str:
        """Return title, table and note as Markdown, with the first column aligned to the left, others to the right."""
        widths = [max(map(len, column)) for column in zip(self.heads, *self.cells, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        lines = []
        for row in (self.heads, rule, *self.cells):
            first, *more = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
            lines.append(f"| {' | '.join([first.strip().ljust(widths[0]), *more])} |")
        return "\n\n".join(filter(None, [f"## {self.title}", "\n".join(lines), fill(self.note, _WIDTH)]))


def number(value: Any, form: str = "") -> str:
    """Return a value as text, NONE without one."""
    return NONE if value is None or pd.isna(value) else format(value, form)


def steering_tables(groups: Sequence[Group], settings: Evaluate) -> list[Table]:
    """Return the tables of all groups: first the errors of each group, then details."""
    tables = [Table(f"Results: {group.title}", _results(group), _RESULTS * (group is groups[0])) for group in groups]
    for group in groups:
        if any(group.labels.values()):
            tables.append(Table(f"Without onsets: {group.title}", _results(group, "without_decisions")))
        tables.append(Table(f"Differences: {group.title}", _differences(group, settings), _DIFFERENCES))
        tables.append(Table(f"Uncertainty: {group.title}", _uncertainty(group), _UNCERTAINTY))
    published = [row for group in groups if group.key == "angle-0" for row in _as_published(group)]
    models = [_model(row) for group in groups for row in group.models]
    tables += [Table("MSE as in the paper's Table 2", published, _PAPER), Table("Models", models)]
    return [table for table in tables if table.rows]


def _name(row: Row) -> str:
    return f"*{row['model']}*" if row["baseline"] else str(row["model"])


def _results(group: Group, part: str = "") -> list[dict[str, str]]:
    rows = []
    for row in group.rows:
        cells = {"model": _name(row)}
        for column, label in group.labels.items():
            scores = (row["test"][column][part] if part else row["test"][column]) or {}
            spread = f" ± {scores['nmse_std']:.3f}" if scores.get("nmse_std") is not None else ""
            known = scores.get("nmse") is not None and not row["baseline"]
            bounds = f" ({interval_text(scores.get('nmse_ci95'))})" if known else ""
            cells[f"nmse {label}".strip()] = number(scores.get("nmse"), ".3f") + spread + bounds
            if not part and not label:
                cells["MAE deg"] = number(np.rad2deg(scores["mae"]) if scores["mae"] is not None else None, ".2f")
                cells["no onsets"] = number((scores["without_decisions"] or {}).get("nmse"), ".3f")
                if scores.get("drift_m_per_100m") is not None:
                    cells["drift"] = f"{scores['drift_m_per_100m']:.1f}"
        if not part:
            cells["parameters"] = number(row.get("parameters"), ",d")
            cells["edges"] = number(row.get("edges_per_frame"), ",.0f")
        rows.append(cells)
    return rows


def _differences(group: Group, settings: Evaluate) -> list[dict[str, str]]:
    best, *others = group.by_error
    return [
        {"models": f"{best['model']} − {other['model']}"}
        | {
            label or "nmse": f"{nmse:+.3f} ({interval_text(bounds, '+.3f')})" if np.isfinite(nmse) else NONE
            for column, label in group.labels.items()
            for nmse, bounds in [difference(group.predictions, best["model"], other["model"], column, settings)]
        }
        for other in others
    ]


def difference(
    predictions: pd.DataFrame, first: str, second: str, column: str, settings: Evaluate
) -> tuple[float, list[float] | None]:
    """Return the paired difference in nmse of two models and its 95 % interval, in the frames where both predict.

    Errors are means over the seeds; NaN without common frames or if the truth is 0 there. `predictions`: see
    :attr:`Group.predictions`.
    """
    true, predicted = predictions[f"true_{column}"], predictions[f"predicted_{column}"]
    known = predictions.assign(error=(predicted - true) ** 2, truth=true).dropna(subset="error")
    frame = ["drive", "frame"]
    errors = [
        known[known["model"] == model].pivot(index=frame, columns="run", values="error").dropna().mean(axis=1)
        for model in (first, second)
    ]
    error = (errors[0] - errors[1]).dropna().sort_index()
    truth = known.drop_duplicates(frame).set_index(frame)["truth"].reindex(error.index).to_numpy()
    if not truth.any():
        return np.nan, None
    drive = error.index.get_level_values("drive").factorize()[0]
    return float(error.sum() / (truth**2).sum()), interval(error.to_numpy(), truth, drive, settings)


def _uncertainty(group: Group) -> list[dict[str, str]]:
    return [
        {
            "model": " ".join([row["model"], label]).strip(),
            "NLL": f"{scores['nll']:.3f}",
            "constant σ": f"{scores['nll_constant']:.3f}",
            "within σ": f"{scores['coverage_68']:.1%}",
            "in 95 % interval": f"{scores['coverage_95']:.1%}",
            "certain half": f"{scores['mae_certain'] / row['test'][column]['mae']:.0%}",
        }
        for row in group.models
        for column, label in group.labels.items()
        if (scores := row["test"][column].get("uncertainty"))
    ]


def _as_published(group: Group) -> list[dict[str, str]]:
    return [
        {"model": _name(row)}
        | {split: number((row[split] or {}).get("steering_rad", {}).get("mse"), ".5f") for split in SPLITS}
        | {f"paper {split}": number(getattr(row.get("paper"), f"{split}_mse", None)) for split in ("train", "test")}
        for row in group.rows
    ]


def _model(row: Row) -> dict[str, str]:
    entry, unpruned = row["entry"], row["edges_per_frame_unpruned"]
    layer, cell = (f" ({entry[key]})" if key in entry else "" for key in ("layer", "cell"))  # of pyg, of ncp
    roads = f" ({entry['roads']} roads)" if entry.get("roads") is not None else ""
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
        "fit": f"{entry['fit_to']}{roads}",
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
    depth = Table("Depth", _depth(scores), _DEPTH)
    built = depth, Table("Classes", classes, _CLASSES), Table("Motion", motion, _MOTION)
    return [table for table in built if table.rows]


def _depth(scores: dict[str, Any]) -> list[dict[str, str]]:
    sources = {"encoder": "depth", "flat ground": "ground_plane"}
    rows = []
    for split, truth in product(SPLITS, ("lidar", "dense")):
        if depth := scores[split][f"depth_{truth}"]:
            row = {"split": split, "truth": truth, "frames": str(depth["frames"])}
            row["coverage"] = f"{depth['coverage']:.1%}"
            for crop, (head, source) in product(("", "_eigen"), sources.items()):
                errors = scores[split][f"{source}_{truth}{crop}"]
                text = "{abs_rel:.3f}, {rmse_m:.2f}, {delta1:.3f}".format_map(errors) if errors else NONE
                row[f"{head}{', Eigen' if crop else ''}"] = text
            rows.append(row)
    return rows
