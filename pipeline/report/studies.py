"""Compare models that differ in one setting (presets/studies.yaml): a table and a figure per setting.

A model of a study is called STUDY-VALUE; sa-gnn-ncp has the default of every study and is a point of each. Pairs of
models, also of other presets, test claims: claims of the paper, and whether the scene helps beyond odometry.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pipeline.base.atomic import replacing
from pipeline.drawing import figure_file
from pipeline.evaluate.errors import interval, interval_text
from pipeline.report.results import Results
from pipeline.report.tables import Table, cells, with_text
from pipeline.settings.evaluate import Evaluate

DEFAULT = "sa-gnn-ncp"
_CURVES = {
    "val.nmse": ("validation", ":", "tab:blue"),
    "test.baselines.odometry.nmse": ("odometry", "--", "tab:orange"),
    "test.baselines.persistence.nmse": ("persistence", "--", "tab:green"),
}


class Study(NamedTuple):
    """The axis of a figure, the default's value, and whether the axis is logarithmic."""

    label: str
    default: float
    logarithmic: bool = False


class Claim(NamedTuple):
    """A claim that `model` is better than `baseline`."""

    text: str
    model: str
    baseline: str


STUDIES = {
    "points": Study("points per frame", 1000, logarithmic=True),
    "k": Study("nearest neighbours per point", 6),
    "keep": Study("kept edges between classes, %", 20),
    "lambda": Study("weight λ of the classes (eq. 7), %", 100),
    "window": Study("input frames per prediction", 8, logarithmic=True),
    "horizon": Study("frames ahead", 0),
    "roads": Study("training drives", 24, logarithmic=True),
}
CLAIMS = (
    Claim("pruning: 20 % of the edges between classes kept, against all", DEFAULT, "keep-100"),
    Claim("semantics: λ = 1 against 0", DEFAULT, "lambda-0"),
    Claim("NCP against LSTM", DEFAULT, "lstm"),
    Claim("the scene, beyond odometry, one second ahead", "motion-10", "motion-10-blind"),
    Claim("the scene of the frame itself, one second ahead", "motion-10", "motion-10-another"),
    Claim("the scene, beyond odometry, one second ahead, leave-one-out", "motion-10-others", "blind-10-others"),
)


def write(results: Results, out: Path, settings: Evaluate) -> str:
    """Write studies.md and a figure per study to folder `out`; return the Markdown.

    Writes nothing and returns an empty text without models of a study or of a claim.
    """
    studies, tested = points(results.models), claims(results, settings)
    if not studies and not tested:
        return ""
    for name, rows in studies.items():
        figure_file.save(figure(STUDIES[name], rows), out / f"{name}.png")
    text = "\n\n".join([*(table(name, rows).markdown() for name, rows in studies.items()), *tested])
    with replacing(out / "studies.md") as unfinished:
        unfinished.write_text(f"{text}\n", encoding="utf-8")
    return text


def points(models: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return study → metrics of its models with their `value`, ascending; for studies with at least two models."""
    if DEFAULT not in set(models["model"]):
        return {}
    studies = {}
    for name, study in STUDIES.items():
        value = models["model"].str.extract(rf"^{name}-(\d+)$", expand=False).astype(float)
        value[models["model"] == DEFAULT] = study.default
        rows = models.assign(value=value).dropna(subset="value").sort_values("value")
        if len(rows) > 1:
            studies[name] = rows
    return studies


def table(name: str, rows: pd.DataFrame) -> Table:
    """Return the table of a study."""
    columns = {
        STUDIES[name].label: ("value", "g"), "test nmse": ("nmse", ""), "95 % interval": ("interval", ""),
        "validation nmse": ("val.nmse", ".3f"), "MAE deg": ("test.mae_deg", ".2f"),
        "edges": ("edges_per_frame", ",.0f"), "parameters": ("parameters", ",d"),
    }  # fmt: skip
    return Table(name, cells(with_text(rows), columns))


def figure(study: Study, rows: pd.DataFrame) -> Figure:
    """Return the figure of a study: test nmse with its spread over seeds and interval, validation, two baselines."""
    columns = ("value", "test.nmse", "test.nmse_low", "test.nmse_high", "test.nmse_std", *_CURVES)
    values, nmse, low, high, std, *curves = rows.reindex(columns=[*columns]).to_numpy(float).T
    figure = Figure(figsize=(5, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.fill_between(values, low, high, color="tab:blue", alpha=0.15, linewidth=0, label="95 % interval, other roads")
    spread = np.nan_to_num(std)
    axes.errorbar(values, nmse, spread, marker="o", capsize=3, color="tab:blue", label="test, ± between seeds")
    for curve, (label, style, colour) in zip(curves, _CURVES.values(), strict=True):
        if not np.isnan(curve).all():
            axes.plot(values, curve, style, color=colour, linewidth=1, label=label)
    if study.logarithmic:
        axes.set_xscale("log")
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.minorticks_off()
    axes.set(xlabel=study.label, ylabel="nmse")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize="x-small")
    return figure


def claims(results: Results, settings: Evaluate) -> list[str]:
    """Return heading and lines of the claims whose models are evaluated; a line has the interval of the difference."""
    models = results.models.set_index("model")
    lines = []
    for claim in CLAIMS:
        if not {claim.model, claim.baseline} <= set(models.index):
            continue
        model, baseline = models.loc[claim.model], models.loc[claim.baseline]
        counted = results.predictions[results.predictions["valid"] == 1]
        _, low, high = difference(counted, claim.model, claim.baseline, settings)
        verdict = "better" if high < 0 else "worse" if low > 0 else "no difference shown"
        lines.append(
            f"- {claim.text}: {verdict}. nmse {model['test.nmse']:.3f} against {baseline['test.nmse']:.3f}, "
            f"difference {interval_text((low, high), '+.3f')} (95 %); {model['parameters']:,} parameters against "
            f"{baseline['parameters']:,}"
        )
    return ["## Claims", "\n".join(lines)] if lines else []


class Difference(NamedTuple):
    """Difference in nmse of two models, NaN without common frames or bends, and its 95 % interval, or NaN."""

    nmse: float
    low: float
    high: float


def difference(
    predictions: pd.DataFrame,
    first: str,
    second: str,
    settings: Evaluate,
    true: str = "steering_rad",
    predicted: str = "predicted_rad",
) -> Difference:
    """Return the paired difference in nmse of two models, in the frames where all their networks predict.

    Args:
        predictions: columns model, run, drive, frame, `true` and `predicted`; rows without one of the values are left
            out.
    """
    index = ["drive", "frame"]
    counted = predictions.dropna(subset=[true, predicted])
    counted = counted.assign(error=(counted[predicted] - counted[true]) ** 2)
    by_frame = [
        counted[counted["model"] == model].pivot(index=index, columns="run", values="error").dropna().mean(axis=1)
        for model in (first, second)
    ]
    frames = counted[counted["model"] == first].drop_duplicates(index).set_index(index)
    frames = frames.assign(error=by_frame[0] - by_frame[1]).dropna(subset="error").sort_index()
    drive = frames.index.get_level_values("drive").factorize()[0]
    error, truth = frames["error"].to_numpy(), frames[true].to_numpy()
    if not truth.any():
        return Difference(np.nan, np.nan, np.nan)
    bounds = interval(error, truth, drive, settings) or (np.nan, np.nan)
    return Difference(float(error.sum() / (truth**2).sum()), *bounds)
