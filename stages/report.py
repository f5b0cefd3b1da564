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
from pipeline.report.origin import origin
from pipeline.report.page import Story, write_page


def main(
    data: Annotated[Path, typer.Option(help="folder with the folders of all stages")] = Path(
        "data"
    ),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write the page with its pictures, the tables, and the files of DVC's metrics and plots.
    Returns `out`.

    Models of the params file that are not evaluated on this machine are named.
    """
    with stage_folder("report", out, params=params) as folder:
        models = entries("models", params)
        evaluated = [
            model for model in models if (data / "evaluate" / model / "metrics.json").is_file()
        ]
        groups = results.load_groups(
            {model: data / "evaluate" / model for model in evaluated}, load(Evaluate, params)
        )
        path = data / "scores" / "metrics.json"
        scores = store.read_json(path, stage="scores") if path.is_file() else None
        path = data / "encoder" / "config.json"
        notes = store.read_json(path, stage="encoder").get("sources", []) if path.is_file() else []
        figures = summary.results(groups, scores)
        steering = tables.steering_tables(groups, figures)
        perceived = tables.perception_tables(scores) if scores else []
        doubts = []
        for kind, row in scores["recorded"].items() if scores else ():
            name = "recorded motion" if kind == "recorded" else kind
            notes += [f"{name}: {line}" for line in row["lines"][:1]]
            doubts += [f"{name}: {line}" for line in row["lines"][1:]]
        sentences = tables.sentences(
            groups, figures, [model for model in models if model not in evaluated]
        )
        first = "\n\n".join(fill(line, 110) for line in sentences)
        all_tables = [*steering.results, *steering.paper, *steering.details, *perceived]
        definitions = [tables.definitions()] if groups else []
        text = "\n\n".join(
            [first, *(table.markdown() for table in all_tables), *definitions]
        ).lstrip()
        origin_text = "Page made at " + ", ".join(" ".join(item) for item in origin().items())
        story = Story(tables.headline(groups, figures), sentences, doubts, origin_text)
        (folder.new / "table.md").write_text(f"{text}\n", encoding="utf-8")
        store.write_json(folder.new / "metrics.json", summary.dvc_metrics(groups, figures))
        store.write_json(folder.new / "results.json", summary.rounded(figures))
        for name in ("learning", "figures"):  # DVC expects each output, even an empty one
            (folder.new / name).mkdir()
        for path in (
            path for model in evaluated for path in (data / "train" / model).rglob("curve.csv")
        ):
            network = ".".join(path.relative_to(data / "train").parts[:-1])  # MODEL.seed-N
            curve = pd.read_csv(path, dtype=str).drop(columns="learning_rate")
            # DVC draws an empty field as 0, and nan as a gap.
            curve.to_csv(
                folder.new / f"learning/{network}.csv",
                index=False,
                lineterminator="\n",
                na_rep="nan",
            )
        pictures = draw(folder.new / "figures", groups, data)
        write_page(
            folder.new / "index.html",
            story,
            groups,
            figures,
            steering,
            [*notes, *perceived],
            pictures,
        )
    print(first, f"Tables: {out.absolute()}/table.md. Page: {out.absolute()}/index.html", sep="\n")
    return out


if __name__ == "__main__":
    console.run(main)
