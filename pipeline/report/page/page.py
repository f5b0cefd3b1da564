"""What stands on the page, and in which order."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.base import store
from pipeline.report import predicted
from pipeline.report.page import plots, structure
from pipeline.report.page.html import Section, markdown, paragraph, picture, plot, write
from pipeline.report.sources import Sources
from pipeline.report.tables import comparison
from pipeline.report.tables.comparison import Result
from pipeline.report.tables.markdown import table


def write_page(
    path: Path,
    results: Sequence[Result],
    steering: str,
    perception: str,
    figures: Mapping[Path, str],
    sources: Sources,
) -> None:
    """Write the page of models that are :func:`comparison.in_order`.

    Args:
        steering, perception: their tables in Markdown.
        figures: picture → caption, of the paper's figures.
    """
    sections = [
        Section("Results", markdown("\n".join(_headline(results)))),
        *_of_horizons(results, sources),
        _figures(figures),
        _structures(results, sources.evaluate),
        _learning(results, sources.train),
        _labels(sources.labels),
        Section("Depth, classes and motion", markdown(perception)) if perception else None,
        _pictures(results, sources.pictures),
        Section("All figures", markdown(steering)),
    ]
    lead = paragraph("Steering angles from 3D structure: what the models saw, what they decided, how wrong they were.")
    write(path, "Steering report", lead, [section for section in sections if section])


def _headline(results: Sequence[Result]) -> list[str]:
    """Return what most people want to know, best first within a horizon, trivial predictors below."""
    header = [
        "model",
        "horizon",
        "test nmse",
        "95 % interval",
        "mean error deg",
        "parameters",
        "edges a frame",
    ]
    body = []
    for group in comparison.by_horizon(results):
        horizon = f"{comparison.horizon(group[0])} frames" if comparison.horizon(group[0]) else "now"
        for result in sorted(group, key=lambda result: result["test"]["nmse"]):
            test, (low, high) = result["test"], result["test"]["nmse_ci95"]
            edges = result["edges_per_frame"]
            body.append([
                f"**{result['model']}**", horizon, f"**{test['nmse']:.3f}**", f"{low:.3f} to {high:.3f}",
                f"{test['mae_deg']:.2f}", f"{result['parameters']:,}", _said(edges, ",.0f"),
            ])  # fmt: skip
        for name, of_split in comparison.baselines(group).items():
            test = of_split["test"] or {"nmse": None, "mae_deg": None}  # as of lidar, where a test drive has no scans
            nmse, error = _said(test["nmse"], ".3f"), _said(test["mae_deg"], ".2f")
            body.append([f"*{name}*", horizon, nmse, "", error, "", ""])
    return [
        *table(header, body),
        "",
        "nmse is the mean squared error divided by that of always predicting zero: 1 is useless, 0 perfect. *zero*, "
        "*train_mean*, *persistence* (told the true angle before) and *odometry* (the angle that two images or scans "
        "measure, held) see no scene.",
    ]


def _of_horizons(results: Sequence[Result], sources: Sources) -> list[Section]:
    """Return what models of one horizon predicted, for they alone predict the same."""
    sections = []
    for group in comparison.by_horizon(results):
        horizon = comparison.horizon(group[0])
        ahead = f", {horizon} frames ahead" if horizon else ""
        of_models = {result["model"]: predicted.read(sources.evaluate / result["model"]) for result in group}
        whole = {model: list(of.values()) for model, of in of_models.items()}
        body = [
            paragraph(
                "First seed of each model. Further models wait in the legend. Drag to zoom, double-click to see all.",
                note=True,
            )
        ]
        for drive in dict.fromkeys(drive for of in of_models.values() for drive in of):
            of_drive = {model: of[drive] for model, of in of_models.items() if drive in of}
            body.append(
                plot(f"time-{horizon}-{drive}", plots.over_time(of_drive), f"{drive}: driven and predicted steering")
            )
        body.append(plot(f"scatter-{horizon}", plots.scatter(whole), "All test frames: predicted over driven steering"))
        body.append(
            plot(f"curvature-{horizon}", plots.by_curvature(group), "Error by the road's curvature, mean over seeds")
        )
        body.append(plot(f"speed-{horizon}", plots.by_speed(whole), "Error by speed"))
        sections.append(Section(f"Predicted steering{ahead}", "\n".join(body)))
    return sections


def _figures(figures: Mapping[Path, str]) -> Section | None:
    body = [picture(path, caption) for path, caption in figures.items()]
    return Section("The paper's figures", "\n".join(body)) if body else None


def _learning(results: Sequence[Result], train: Path) -> Section | None:
    # A model's own is that of its first seed; with folds it has none, and the first fold's stands for it.
    found = {result["model"]: sorted((train / result["model"]).rglob("curve.csv")) for result in results}
    curves = {model: files[0] for model, files in found.items() if files}
    if not curves:
        return None
    caption = "Training loss (dotted) and validation nmse of each model's first network"
    return Section("Learning curves", plot("learning", plots.learning(curves), caption))


def _structures(results: Sequence[Result], evaluate: Path) -> Section | None:
    for result in results:
        path = evaluate / result["model"] / "structure.json"
        shown = store.read_json(path, stage=f"evaluate@{result['model']}") if path.is_file() else {}
        if shown:
            variant = result["variant"]
            said = paragraph(
                f"What {result['model']} saw where each test drive bends most. A click on the legend shows or hides "
                "classes, and edges before and after semantic pruning. Turn with the mouse or a finger."
            )
            figures = [
                plot(
                    f"structure-{drive}",
                    structure.draw(of, variant["k"]),
                    f"{drive}, frame {of['frame']}, {of['points']} points",
                )
                for drive, of in shown.items()
            ]
            return Section("The cloud and its graph", "\n".join([said, *figures]))
    return None


def _labels(labels: Path) -> Section | None:
    if not (labels / "summary.json").is_file():
        return None
    summary: Mapping[str, Any] = store.read_json(labels / "summary.json", stage="labels")
    header = [
        "drive", "frames", "valid", "mean abs steering rad", "largest", "mean square rad²", "longest step s",
        "reversing", "sideways",
    ]  # fmt: skip
    rows = [
        [drive, str(of["frames"]), _said(of["valid_share"], ".1%"), _said(of["mean_abs_steering_rad"], ".3f"),
         _said(of["max_abs_steering_rad"], ".3f"), _said(of["zero_mse_rad2"], ".5f"), _said(of["dt_max_s"], ".3f"),
         str(of["reversing_frames"]), str(of["sideways_frames"])]
        for drive, of in summary.items()
    ]  # fmt: skip
    note = (
        "Mean square: the error of always predicting 0. Frames that reverse or go sideways, and steps much longer than "
        "0.1 s, ask for a look before the labels are trusted."
    )
    return Section("Plausibility of the labels", markdown("\n".join(table(header, rows))) + paragraph(note, note=True))


def _said(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _pictures(results: Sequence[Result], pictures: Path) -> Section | None:
    """Return the sheets of the test drives: those that the models had not seen."""
    tested = dict.fromkeys(drive for result in results for drive in result["drives"]["test"])
    sheets = [pictures / f"{drive}.png" for drive in tested if (pictures / f"{drive}.png").is_file()]
    body = [picture(sheet, f"{sheet.stem}: image, depth, classes, cloud from above") for sheet in sheets]
    return Section("What the models were given", "\n".join(body)) if body else None
