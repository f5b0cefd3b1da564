"""Compare all models: data/report/{index.html, table.md, metrics.json, …}."""

from pathlib import Path
from textwrap import fill
from typing import Annotated

import pandas as pd
import typer

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import entries, load
from pipeline.evaluate.settings import Evaluate
from pipeline.report import results, summary, tables
from pipeline.report.figures import draw
from pipeline.report.page import write_page


def main(
    data: Annotated[Path, typer.Option(help="folder with the folders of all stages")] = Path("data"),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write the page with its pictures, the tables, and the files of DVC's metrics and plots. Returns `out`.

    Models of the params file that are not evaluated on this machine are named.
    """
    with stage_folder("report", out, params=params) as folder:
        models = entries("models", params)
        evaluated = [model for model in models if (data / "evaluate" / model / "metrics.json").is_file()]
        groups = results.load_groups({model: data / "evaluate" / model for model in evaluated}, load(Evaluate, params))
        path = data / "scores" / "metrics.json"
        scores = store.read_json(path, stage="scores") if path.is_file() else None
        path = data / "encoder" / "config.json"
        notes = store.read_json(path, stage="encoder").get("sources", []) if path.is_file() else []
        steering = tables.steering_tables(groups)
        perceived = tables.perception_tables(scores) if scores else []
        for kind, row in scores["recorded"].items() if scores else ():
            notes += [f"{'recorded motion' if kind == 'recorded' else kind}: {line}" for line in row["lines"]]
        story = tables.sentences(groups, [model for model in models if model not in evaluated])
        first = "\n\n".join(fill(line, 110) for line in story)
        text = "\n\n".join([first, *(table.markdown() for table in (*steering, *perceived))]).lstrip()
        (folder.new / "table.md").write_text(f"{text}\n", encoding="utf-8")
        store.write_json(folder.new / "metrics.json", results.dvc_metrics(groups))
        store.write_json(folder.new / "results.json", summary.results(groups, scores))
        for name in ("learning", "figures"):  # DVC expects each output, even an empty one
            (folder.new / name).mkdir()
        for path in (path for model in evaluated for path in (data / "train" / model).rglob("curve.csv")):
            network = ".".join(path.relative_to(data / "train").parts[:-1])  # MODEL.seed-N
            curve = pd.read_csv(path, dtype=str).drop(columns="learning_rate")
            # DVC draws an empty field as 0, and nan as a gap.
            curve.to_csv(folder.new / f"learning/{network}.csv", index=False, lineterminator="\n", na_rep="nan")
        figures = draw(folder.new / "figures", groups, data)
        write_page(folder.new / "index.html", story, groups, steering, [*notes, *perceived], figures)
    print(first, f"Tables: {out.absolute()}/table.md. Page: {out.absolute()}/index.html", sep="\n")
    return out


if __name__ == "__main__":
    console.run(main)
