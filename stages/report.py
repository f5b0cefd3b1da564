"""Put the evaluated models side by side: data/report/{table.md, table.csv, metrics.json, learning/, steering/}."""

import csv
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.atomic import replacing
from pipeline.base.lock import held
from pipeline.base.params import names
from pipeline.report.tables import (
    comparison,
    curves,
    metrics,
    motion_table,
    perception_table,
    steering_rows,
    steering_table,
)  # fmt: skip


def main(
    evaluate: Path = Path("data/evaluate"),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
    scores: Path = Path("data/scores"),
    train: Path = Path("data/train"),
) -> Path:
    """Write each model of the params file on the test drives, the trivial predictors, what depth and motion are worth.

    Beside the table, the same for DVC's own views: flat figures, learning curves, driven and predicted steering.
    Models that are not evaluated here are named. Returns `out`.
    """
    models = names("models", params)
    here = [model for model in models if (evaluate / model / "metrics.json").is_file()]
    results = comparison.in_order(
        [store.read_json(evaluate / model / "metrics.json", stage=f"evaluate@{model}") for model in here]
    )
    # A machine that only trains may have no scores of the encoder.
    known = (scores / "metrics.json").is_file()
    encoder = store.read_json(scores / "metrics.json", stage="scores") if known else None

    text = steering_table.markdown(results, absent=[model for model in models if model not in here])
    if encoder:
        text += "\n" + perception_table.markdown(encoder)
        if motion := motion_table.markdown(encoder.get("motion", {})):
            text += "\n" + motion
    with held(out, out.parent / ".resume" / out.name):
        with replacing(out / "table.md") as tmp:
            tmp.write_text(text, encoding="utf-8")
        with replacing(out / "table.csv") as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
            rows = steering_rows.rows(results)
            table = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
            table.writeheader()
            table.writerows(rows)
        store.write_json(out / "metrics.json", metrics.figures(results, encoder))
        for folder in ("learning", "steering"):  # DVC misses an out that is not there, be it empty
            (out / folder).mkdir(exist_ok=True)
        for model in here:
            curves.write_learning(train / model, out / "learning")
            curves.write_steering(evaluate / model, out / "steering")
    print(text)
    return out


if __name__ == "__main__":
    console.run(main)
