"""Stage report: compare all models, and write data/report/{index.html, table.md, …}."""

from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

import typer

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import entries, load
from pipeline.evaluate.settings import Evaluate
from pipeline.report import page, summary, tables
from pipeline.report.results import load_groups
from pipeline.report.summary import Comparison


def main(
    data: Annotated[Path, typer.Option(help="folder with the folders of all stages")] = Path(
        "data"
    ),
    out: Annotated[Path | None, typer.Option(help="default: report in --data")] = None,
    params: Path = Path("params.yaml"),
) -> Path:
    """Write the page with its pictures, the tables, and the file of DVC's metrics.

    The report also names the models of the params file that are not evaluated on this machine.
    Returns the folder.
    """
    out = out or data / "report"
    with stage_folder("report", out, params=params) as folder:
        models = entries("models", params)
        evaluated = [name for name in models if (data / f"evaluate/{name}/metrics.json").is_file()]
        absent = [name for name in models if name not in evaluated]
        groups = load_groups({name: data / "evaluate" / name for name in evaluated})
        scores = _read_json(data / "scores/metrics.json", "scores")
        encoder = _read_json(data / "encoder/config.json", "encoder")

        # All values are computed here, once: tables, page and DVC's metrics show them.
        values = summary.results(groups, load(Evaluate, params), scores)
        store.write_json(folder.new / "results.json", summary.rounded(values), sort_keys=False)
        store.write_json(folder.new / "metrics.json", summary.dvc_metrics(values), sort_keys=False)
        comparisons = [Comparison(values, group.key) for group in groups]

        sentences = tables.sentences(comparisons, absent)
        steering, details = tables.steering_tables(comparisons, groups)
        perceived = tables.perception_tables(scores)
        text = "\n\n".join(fill(sentence, 110) for sentence in sentences)
        sections = [table.section() for table in (*steering, *details, *perceived)]
        table = "\n\n".join([text, *sections, tables.definitions()])
        store.write_text(folder.new / "table.md", table.lstrip())

        pictures = folder.new / "figures"
        pictures.mkdir()  # DVC expects each output, even an empty one
        content: dict[str, page.Content] = {"Errors": page.errors(comparisons)}
        bend = None
        if groups:
            bend = page.bend(pictures, groups[0], comparisons[0], data / "ingest")
            content["From image to graph"] = page.chain(pictures, groups[0], comparisons[0], data)
        content |= {table.title: [table] for table in steering}
        for group, comparison in zip(groups, comparisons, strict=True):
            title = f"Test drives: {comparison.title}"
            content[title] = page.test_drives(pictures, group, comparison, data / "ingest")
        content["Learning curves"] = page.learning(data / "train", evaluated)
        content |= {table.title: [table] for table in (*details, *perceived)}
        notes, doubts = tables.recorded_motion(scores)
        doubts += tables.few_turns(comparisons)
        content["Notes"] = [*encoder.get("sources", []), *notes]
        content["Definitions"] = [f"{word}: {text}" for word, text in tables.DEFINITIONS.items()]
        page.write(folder.new / "index.html", page.Page(sentences, bend, doubts, content))
    print(text, f"Tables: {out.absolute()}/table.md. Page: {out.absolute()}/index.html", sep="\n")
    return out


def _read_json(path: Path, stage: str) -> dict[str, Any]:
    """Return the content of a file by a stage, or an empty one if there is no file."""
    return store.read_json(path, stage=stage) if path.is_file() else {}


if __name__ == "__main__":
    console.run(main)
