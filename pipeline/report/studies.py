"""What one setting is worth: a figure and a table for each study of presets/studies.yaml, and the paper's claims.

A model of a study is called STUDY-VALUE; sa-gnn-ncp has the default of every study and is a point of each.
"""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from pipeline.base import console, store
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError
from pipeline.base.params import load
from pipeline.report.judge.interval import difference_interval
from pipeline.report.tables.markdown import table
from pipeline.sections.evaluate import Evaluate
from pipeline.train import runs

Result = dict[str, Any]  # a model's metrics.json
DEFAULT = "sa-gnn-ncp"
COLUMNS = ("model", "test nmse", "95 % interval", "validation nmse", "MAE deg", "edges a frame", "parameters")


class Study(NamedTuple):
    """The axis of a figure, the default's place on it, and whether it is logarithmic."""

    label: str
    default: float
    logarithmic: bool = False


STUDIES = {
    "points": Study("points a frame", 1000, logarithmic=True),
    "k": Study("nearest neighbours of a point", 6),
    "keep": Study("edges between classes that are kept, %", 20),
    "lambda": Study("weight λ of the classes (eq. 7), %", 100),
    "window": Study("frames that a prediction sees", 8, logarithmic=True),
    "horizon": Study("frames ahead", 0),
    "roads": Study("training drives", 24, logarithmic=True),
}


class Claim(NamedTuple):
    """What the paper says, and the two models whose difference bears on it, the paper's side first."""

    text: str
    ours: str
    other: str


CLAIMS = (
    Claim("pruning: 20 % of the edges between classes kept, against all", DEFAULT, "keep-100"),
    Claim("semantics: λ = 1 against 0", DEFAULT, "lambda-0"),
    Claim("NCP against LSTM", DEFAULT, "lstm"),
)


def main(
    evaluate: Annotated[Path, typer.Option(help="of a run of presets/studies.yaml")] = Path("data/evaluate"),
    out: Path = Path("data/report/studies"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write OUT.md and OUT.csv, and a figure of each study into OUT/. Studies without a model here are left out."""
    results = {
        folder.name: store.read_json(folder / "metrics.json", stage=f"evaluate@{folder.name}")
        for folder in sorted(evaluate.iterdir() if evaluate.is_dir() else ())
        if (folder / "metrics.json").is_file()
    }
    if DEFAULT not in results:
        raise InputError(f"{evaluate} holds no model {DEFAULT!r}: run make studies first")
    out.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    rows: list[dict[str, Any]] = []
    for name, study in STUDIES.items():
        points = points_of(name, study, results)
        if len(points) > 1:
            draw(out / f"{name}.png", study, points)
            lines += [f"## {name}: {study.label}", "", *table(COLUMNS, [_cells(value, r) for value, r in points]), ""]
            rows += [_row(name, value, result) for value, result in points]
    lines += ["## The paper's claims", "", *claims(results, evaluate, load(Evaluate, params))]
    with replacing(out.with_suffix(".md")) as tmp:
        tmp.write_text("\n".join([*lines, ""]), encoding="utf-8")
    with replacing(out.with_suffix(".csv")) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print("\n".join(lines))
    return out


def points_of(name: str, study: Study, results: Mapping[str, Result]) -> list[tuple[float, Result]]:
    """Return (value, metrics) of a study's models and of the default, by value."""
    found = {study.default: results[DEFAULT]}
    for model, result in results.items():
        prefix, _, value = model.rpartition("-")
        if prefix == name and value.isdecimal():
            found[float(value)] = result
    return sorted(found.items())


def draw(path: Path, study: Study, points: Sequence[tuple[float, Result]]) -> None:
    """Draw test nmse over the study's values, its spread over seeds, its interval, and the measured angle's nmse."""
    from matplotlib.figure import Figure

    values = [value for value, _ in points]
    tests = [result["test"] for _, result in points]
    nmse = [test["nmse"] for test in tests]
    figure = Figure(figsize=(5, 3.4), layout="constrained")
    axes = figure.subplots()
    low, high = np.array([test["nmse_ci95"] for test in tests]).T
    axes.fill_between(values, low, high, color="tab:blue", alpha=0.15, linewidth=0, label="95 % interval, other roads")
    spread = [test["nmse_std"] or 0.0 for test in tests]
    axes.errorbar(values, nmse, spread, marker="o", capsize=3, color="tab:blue", label="test, ± between seeds")
    axes.plot(values, [result["val"]["nmse"] for _, result in points], ":", color="tab:blue", label="validation")
    for baseline, colour in (("odometry", "tab:orange"), ("persistence", "tab:green")):
        held = [test["baselines"].get(baseline, {}).get("nmse", np.nan) for test in tests]
        axes.plot(values, held, "--", color=colour, linewidth=1, label=baseline)
    if study.logarithmic:
        axes.set_xscale("log")
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.minorticks_off()
    axes.set_xlabel(study.label)
    axes.set_ylabel("nmse")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize="x-small")
    with replacing(path) as tmp:
        figure.savefig(tmp, dpi=110, metadata={"Software": None})


def _cells(value: float, result: Result) -> list[str]:
    test, edges = result["test"], result["edges_per_frame"]
    return [
        f"{value:g}",
        f"{test['nmse']:.3f}" + (f" ± {test['nmse_std']:.3f}" if test["nmse_std"] is not None else ""),
        "{:.3f} to {:.3f}".format(*test["nmse_ci95"]),
        f"{result['val']['nmse']:.3f}",
        f"{test['mae_deg']:.2f}",
        "" if edges is None else f"{edges:,.0f}",
        f"{result['parameters']:,}",
    ]


def _row(study: str, value: float, result: Result) -> dict[str, Any]:
    test = result["test"]
    low, high = test["nmse_ci95"]
    return {
        "study": study, "value": f"{value:g}", "model": result["model"], "seeds": len(result["seeds"]),
        "test_nmse": test["nmse"], "test_nmse_std": test["nmse_std"], "test_nmse_low": low, "test_nmse_high": high,
        "val_nmse": result["val"]["nmse"], "test_mae_deg": test["mae_deg"],
        "edges_per_frame": result["edges_per_frame"], "parameters": result["parameters"],
    }  # fmt: skip


def claims(results: Mapping[str, Result], evaluate: Path, settings: Evaluate) -> list[str]:
    """Return a line for each claim whose models are here: both errors, and the interval of their difference."""
    lines = []
    for claim in CLAIMS:
        if claim.ours not in results or claim.other not in results:
            continue
        ours, other = results[claim.ours], results[claim.other]
        truth, drive, angles, others = _predictions(evaluate, ours, other)
        low, high = difference_interval(
            truth,
            angles,
            others,
            drive,
            settings.bootstrap_block_frames,
            settings.bootstrap_samples,
            settings.seed,
        )
        verdict = "better" if high < 0 else "worse" if low > 0 else "no difference shown"
        lines.append(
            f"- {claim.text}: {verdict}. nmse {ours['test']['nmse']:.3f} against {other['test']['nmse']:.3f}, "
            f"difference {low:+.3f} to {high:+.3f} (95 %); {ours['parameters']:,} parameters against "
            f"{other['parameters']:,}"
        )
    return lines


def _predictions(evaluate: Path, ours: Result, other: Result) -> tuple[np.ndarray, ...]:
    """Return truth and drive number [N] of the frames where all networks predict, and each model's angles [S,N]."""
    tables = [
        [
            _read(folder / "predictions.csv")
            for folder in runs.folders(evaluate / each["model"], each["seeds"]).values()
        ]
        for each in (ours, other)
    ]
    common = sorted(set.intersection(*(set(of_seed) for of_model in tables for of_seed in of_model)))
    names = sorted({drive for drive, _ in common})
    truth = np.array([tables[0][0][key][0] for key in common])
    drive = np.array([names.index(name) for name, _ in common])
    return truth, drive, *(np.array([[of_seed[key][1] for key in common] for of_seed in each]) for each in tables)


def _read(path: Path) -> dict[tuple[str, int], tuple[float, float]]:
    """Return (drive, frame) → (truth, prediction) of the frames that count."""
    with path.open(newline="", encoding="utf-8") as file:
        return {
            (row["drive"], int(row["frame"])): (float(row["steering_rad"]), float(row["predicted_rad"]))
            for row in csv.DictReader(file)
            if row["valid"] == "1" and row["predicted_rad"]
        }


if __name__ == "__main__":
    console.run(main)
