"""Put models side by side: data/report/{index.html, table.md, table.csv, metrics.json, …}."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base import console, store
from pipeline.base.atomic import replacing
from pipeline.base.lock import exclusive
from pipeline.base.params import load, names
from pipeline.report.figures import figures
from pipeline.report.page.page import write_page
from pipeline.report.sources import Sources
from pipeline.report.studies import claims, figure, study, tables
from pipeline.report.tables import (
    comparison,
    csv_file,
    curves,
    metrics,
    motion_table,
    perception_table,
    steering_rows,
    steering_table,
)  # fmt: skip
from pipeline.report.tables.result import Result
from pipeline.sections.evaluate import Evaluate


def main(
    data: Annotated[Path, typer.Option(help="holds the folders of all stages")] = Path("data"),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write each model of the params file on the test drives, the trivial predictors, what depth and motion are worth.

    As tables, as a page to look at, and for DVC's own views: flat figures, learning curves, driven and predicted
    steering. The paper's figures, and what single settings are worth, if there are models of a study. Models that are
    not evaluated here are named. Returns `out`.
    """
    sources, models = Sources(data), names("models", params)
    here = [model for model in models if (sources.evaluate / model / "metrics.json").is_file()]
    results = comparison.in_order(
        [
            store.read_json(sources.evaluate / model / "metrics.json", stage=f"evaluate@{model}", form=Result)
            for model in here
        ]
    )
    # A machine that only trains may have no scores of the encoder.
    known = (sources.scores / "metrics.json").is_file()
    encoder = store.read_json(sources.scores / "metrics.json", stage="scores") if known else None

    steering = steering_table.markdown(results, absent=[model for model in models if model not in here])
    perceived = write_perception(encoder) if encoder else ""
    text = "\n".join(filter(None, [steering, perceived]))
    with exclusive(out, out.parent / ".resume" / out.name):
        with replacing(out / "table.md") as tmp:
            tmp.write_text(text, encoding="utf-8")
        csv_file.write(out / "table.csv", steering_rows.rows(results))
        store.write_json(out / "metrics.json", metrics.figures(results, encoder))
        for folder in ("learning", "steering", "settings", "figures"):  # DVC misses an out that is not there
            (out / folder).mkdir(exist_ok=True)
        for model in here:
            curves.write_learning(sources.train / model, out / "learning")
            curves.write_steering(sources.evaluate / model, out / "steering")
        drawn = figures.draw(out / "figures", results, sources)
        write_page(out / "index.html", results, steering, perceived, drawn, sources)
        text += write_studies(results, sources.evaluate, out / "settings", load(Evaluate, params))
    print(text)
    return out


def write_perception(scores: dict[str, Any]) -> str:
    """Return the tables of what depth, classes and motion are worth."""
    motion = motion_table.markdown(scores.get("motion", {}))
    return "\n".join(filter(None, [perception_table.markdown(scores), motion]))


def write_studies(results: Sequence[dict[str, Any]], evaluate: Path, out: Path, settings: Evaluate) -> str:
    """Write table.md, table.csv and figures of what single settings are worth; return the tables.

    Nothing, where no model is of a study.
    """
    studies = study.points(results)
    if not studies:
        return ""
    for name, points in studies.items():
        figure.draw(out / f"{name}.png", study.STUDIES[name], points)
    lines = [line for name, points in studies.items() for line in tables.markdown(name, points)]
    text = "\n".join([*lines, *claims.markdown(results, evaluate, settings)])
    with replacing(out / "studies.md") as tmp:
        tmp.write_text(text, encoding="utf-8")
    csv_file.write(out / "studies.csv", [row for name, points in studies.items() for row in tables.rows(name, points)])
    return f"\n{text}"


if __name__ == "__main__":
    console.run(main)
