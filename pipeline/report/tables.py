"""Build the tables of models and baselines as text, for table.md and for the page, and the rows of table.csv."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import NamedTuple

import pandas as pd

from pipeline.base.params import SPLITS
from pipeline.evaluate.errors import interval_text
from pipeline.report.results import Results, columns_below

Columns = Mapping[str, tuple[str, str]]
"""Heading → column and format; an empty format for text."""
NONE = "–"  # cell without a value
_WIDTH = 110  # characters per line of a note
_SETTINGS = (
    "input", "spatial", "temporal", "cell", "equivariant", "semantics", "window", "motion", "horizon", "fit_to",
    "roads",
)  # fmt: skip
_SIZES = ("points_per_frame", "parameters", "edges_per_frame", "edges_per_frame_unpruned", "seeds")
_METRICS = (
    "nmse = MSE / MSE of always predicting zero: 0 is perfect, 1 is useless. MAE: mean absolute error. ahead: frames "
    "from the last input frame to the predicted angle. no onsets: nmse without the frames around the onset of a turn, "
    "where the driver's choice is unknown (pipeline/evaluate/decisions.py). edges: directed kNN edges per frame "
    "after pruning, as in the paper. Baselines: zero and train_mean predict a constant; persistence repeats the last "
    "true angle, which no model gets; odometry repeats the angle measured from the last two images or scans; "
    "regression multiplies it by its regression coefficient on the training drives."
)
_PAPER = (
    "MSE in rad². paper: its Table 2, for models with the settings of one of its networks. With the paper's own label, "
    "always predicting zero has 0.0137 rad² on KITTI's longest drive, below all of its test errors, so the paper's "
    "unit cannot be rad² of this label: compare order and ratio only."
)
_UNCERTAINTY = (
    "NLL: mean negative log-likelihood in nats of the angle in rad under a normal distribution with the predicted σ, "
    "which is scaled on the validation drives; constant σ: the same with the best single σ for these frames. within "
    "σ: share of the true angles that differ from the prediction by at most σ. in 95 % interval: by at most the "
    "multiple of σ that covers 95 % of the validation errors. certain half: the frames with the smaller σ."
)


class Table(NamedTuple):
    """A table of text cells with a title and a note."""

    title: str
    cells: pd.DataFrame
    note: str = ""

    def markdown(self) -> str:
        """Return title, table and note as Markdown, with the first column aligned to the left, others to the right."""
        head, body = [*self.cells], self.cells.to_numpy().tolist()
        widths = [max(map(len, column)) for column in zip(head, *body, strict=True)]
        rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
        lines = []
        for row in (head, rule, *body):
            first, *more = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
            lines.append(f"| {' | '.join([first.strip().ljust(widths[0]), *more])} |")
        return "\n\n".join(filter(None, [f"## {self.title}", "\n".join(lines), fill(self.note, _WIDTH)]))


def cells(rows: pd.DataFrame, columns: Columns) -> pd.DataFrame:
    """Return `columns` of `rows` as text; a column that no row has is empty."""
    texts = {
        head: [NONE if pd.isna(value) else format(value, form) for value in rows.get(column, [None] * len(rows))]
        for head, (column, form) in columns.items()
    }
    return pd.DataFrame(texts, columns=[*columns])


def with_text(metrics: pd.DataFrame) -> pd.DataFrame:
    """Return the metrics with text columns: name (of baselines in *), nmse with its spread over seeds, interval."""
    rows = metrics[["model", "baseline", *(f"test.nmse{key}" for key in ("", "_std", "_low", "_high"))]]
    texts = [
        {
            "name": f"*{model}*" if baseline else model,
            "nmse": (NONE if pd.isna(nmse) else f"{nmse:.3f}") + ("" if pd.isna(std) else f" ± {std:.3f}"),
            "interval": None if baseline or pd.isna(nmse) else interval_text((low, high)),
        }
        for model, baseline, nmse, std, low, high in rows.itertuples(index=False, name=None)
    ]
    return metrics.join(pd.DataFrame(texts, index=metrics.index))


def steering_tables(results: Results) -> list[Table]:
    """Return the tables of models and baselines: errors, settings, MSE as in the paper, by drive, by curvature."""
    if results.metrics.empty:
        return []
    rows = with_text(results.metrics)
    start = {"model": ("name", ""), "ahead": ("line.horizon", "")}
    errors = {
        "test nmse": ("nmse", ""), "95 % interval": ("interval", ""), "MAE deg": ("test.mae_deg", ".2f"),
        "no onsets": ("test.without_decisions.nmse", ".3f"), "parameters": ("parameters", ",d"),
        "edges": ("edges_per_frame", ",.0f"),
    }  # fmt: skip
    mse = {split: (f"{split}.mse_rad2", ".5f") for split in SPLITS}
    published = {f"paper {split}": (f"paper.{split}_mse", "") for split in ("train", "test")}
    tables = [
        Table("Results", cells(rows, start | errors), f"{_METRICS} {_seeds(results.models)}"),
        Table("Models", _settings(results.models)),
        Table("MSE as in the paper's Table 2", cells(rows, start | mse | published), _PAPER),
    ]
    drives = columns_below(rows, "test.by_drive", "nmse")
    if len(drives) > 1:
        tables.append(Table("nmse by test drive", _by_drive(rows, drives)))
    bins = columns_below(rows, "test.by_curvature", "rmse_deg")
    binned = rows[rows[[*bins.values()]].notna().any(axis=1)]
    if len(binned):
        counts = ", ".join(str(binned.iloc[0][f"test.by_curvature.{name}.frames"]) for name in bins)
        note = f"RMSE in degrees by |curvature| of the road; {counts} frames for {binned.iloc[0]['model']}."
        by_bin = {f"{name} 1/m": (column, ".2f") for name, column in bins.items()}
        tables.append(Table("RMSE by curvature", cells(binned, start | by_bin), note))
    if "test.uncertainty.nll" in rows:
        columns = {
            "model": ("model", ""), "NLL": ("test.uncertainty.nll", ".3f"),
            "constant σ": ("test.uncertainty.nll_constant", ".3f"),
            "within σ": ("test.uncertainty.coverage_68", ".1%"),
            "in 95 % interval": ("test.uncertainty.coverage_95", ".1%"),
            "MAE deg, certain half": ("test.uncertainty.mae_deg_certain", ".2f"), "all": ("test.mae_deg", ".2f"),
        }  # fmt: skip
        tables.append(Table("Uncertainty", cells(rows.dropna(subset="test.uncertainty.nll"), columns), _UNCERTAINTY))
    return tables


def _by_drive(rows: pd.DataFrame, drives: Mapping[str, str]) -> pd.DataFrame:
    """Return a row per drive and a column per model or baseline, so that many drives fit; `drives`: name → column."""
    horizons = rows["line.horizon"]
    heads = rows["name"] + ("" if horizons.nunique() < 2 else " +" + horizons.astype(str))
    by_drive = rows[[*drives.values()]].set_axis([*drives], axis=1).T.set_axis([*heads], axis=1)
    texts = by_drive.map(lambda nmse: NONE if pd.isna(nmse) else f"{nmse:.3f}")
    return texts.rename_axis("drive").reset_index()


def _settings(models: pd.DataFrame) -> pd.DataFrame:
    entries = models.filter(regex=r"^line\.\w+$").rename(columns=lambda column: column.removeprefix("line."))
    rows = pd.concat([models[["model", *_SIZES]], entries.reindex(columns=[*_SETTINGS])], axis=1)
    edges, unpruned = (rows[name].astype(float) for name in ("edges_per_frame", "edges_per_frame_unpruned"))
    rows["pruned"] = 1 - edges / unpruned  # NaN without edges
    rows["temporal"] += [f" ({cell})" if cell else "" for cell in rows["cell"].where(rows["temporal"] == "ncp", "")]
    rows["fit_to"] += [f" ({roads} roads)" if pd.notna(roads) else "" for roads in rows["roads"]]
    columns = {
        "model": ("model", ""), "input": ("input", ""), "points": ("points_per_frame", ",.0f"),
        "edges": ("edges_per_frame_unpruned", ",.0f"), "pruned": ("pruned", ".0%"),
    }  # fmt: skip
    columns |= {name: (name, "") for name in ("semantics", "spatial", "temporal", "window", "equivariant", "motion")}
    return cells(rows, columns | {"fit": ("fit_to", "")})


def _seeds(models: pd.DataFrame) -> str:
    low, high = models["seeds"].min(), models["seeds"].max()
    if high == 1:
        return "One seed per model: the spread between trainings is unknown."
    count = high if low == high else f"{low} to {high}"
    return (
        f"Means over {count} seeds, ± one standard deviation between seeds. The interval is for other roads (block "
        "bootstrap over the test frames), given these networks."
    )


def csv_rows(metrics: pd.DataFrame) -> pd.DataFrame:
    """Return the metrics under the column names of table.csv."""
    if metrics.empty:
        return pd.DataFrame()
    drives = columns_below(metrics, "test.by_drive", "nmse")
    bins = columns_below(metrics, "test.by_curvature", "rmse_deg")
    names = {"model": "model", **{name: f"line.{name}" for name in _SETTINGS}, **{name: name for name in _SIZES}}
    names |= {f"{split}_mse_rad2": f"{split}.mse_rad2" for split in SPLITS}
    names |= {f"test_{name}": f"test.{name}" for name in ("frames", "nmse", "mae_deg")}
    if len(drives) > 1:
        names |= {f"test_nmse {drive}": column for drive, column in drives.items()}
    names |= {f"test_without_decisions_{name}": f"test.without_decisions.{name}" for name in ("frames", "nmse")}
    names |= {f"test_nmse_{name}": f"test.nmse_{name}" for name in ("std", "low", "high")}
    names |= {f"test_rmse_deg {name} 1/m": column for name, column in bins.items()}
    names |= {f"paper_{split}_mse": f"paper.{split}_mse" for split in ("train", "test")}
    return metrics.reindex(columns=[*names.values()]).set_axis([*names], axis=1)


def missing(models: Sequence[str]) -> str:
    """Return a line per model that is not evaluated on this machine, with the command that gets it."""
    lines = [f"{name} is not evaluated here. Run: dvc repro --pull --downstream train@{name}" for name in models]
    return "\n\n".join(lines)
