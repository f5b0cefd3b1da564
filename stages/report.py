"""Put the evaluated models side by side: data/report/{table.md, table.csv}."""

import csv
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.params import names
from pipeline.report import perception_table as score_card
from pipeline.report import tables


def main(
    evaluate: Path = Path("data/evaluate"),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
    perception: Path = Path("data/perception"),
) -> None:
    """Write each model of the params file on the test drives, the trivial predictors, and what depth is worth."""
    results, absent = [], []
    for model in names("models", params):
        if (evaluate / model / "metrics.json").is_file():
            results.append(store.read_json(evaluate / model / "metrics.json", stage=f"evaluate@{model}"))
        else:
            absent.append(model)
    text = tables.markdown(results, absent)
    scores = perception / "metrics.json"
    if scores.is_file():  # a machine that only trains may lack it
        text += "\n" + score_card.markdown(store.read_json(scores, stage="perception"))
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text(text, encoding="utf-8")
    with (out / "table.csv").open("w", newline="", encoding="utf-8") as file:
        rows = tables.rows(results)
        table = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    print(text)


if __name__ == "__main__":
    console.run(main)
