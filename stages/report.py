"""Stage report: compare all models, and write data/report/{index.html, table.md, …}."""

from pathlib import Path
from textwrap import fill
from typing import Any

from pipeline.jobs import console
from pipeline.jobs.origin import describe_origin, format_duration, read_run
from pipeline.jobs.outputs import stage_folder

from pipeline.base import store
from pipeline.base.params import load_section, read_entries
from pipeline.base.summary import split_doubts
from pipeline.evaluate.settings import Evaluate
from pipeline.ingest.settings import Ingest
from pipeline.report import drawings, page, sentences, tables
from pipeline.report.curves import gather_curves
from pipeline.report.definitions import define_words, write_definitions
from pipeline.report.scores_tables import scores_tables
from pipeline.report.values import dvc_metrics, frames_of, gather_values, load_tasks, to_json

# Sentence about results on the embedded sample.
RENDERED = (
    "All streets are rendered. At each turn, barriers close the streets that the car does not "
    "take, so the scene shows where the path goes."
)


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Write the page with its pictures, the tables, and the files of DVC's metrics and plots.

    The report also names the models of the params file that are not evaluated on this machine.
    Returns the folder.
    """
    out = data / "report"
    with stage_folder("report", out, params=params) as folder:
        models = read_entries("models", params)
        evaluated = [name for name in models if (data / f"evaluate/{name}/metrics.json").is_file()]
        absent = [name for name in models if name not in evaluated]
        tasks = load_tasks({name: data / "evaluate" / name for name in evaluated})
        scores = _read_json(data / "scores/metrics.json", "scores")
        encoder = _read_json(data / "encoder/config.json", "encoder")

        # All values are computed here, once: tables, page and DVC's metrics show them.
        values = gather_values(tasks, load_section(Evaluate, params))
        rows = to_json(values) | {"frames": frames_of(tasks), "scores": scores}
        store.write_json(folder.new / "results.json", rows, sort_keys=False)
        (folder.new / "metrics").mkdir()
        for metric, numbers in dvc_metrics(values).items():
            store.write_json(folder.new / f"metrics/{metric}.json", numbers, sort_keys=False)
        curves = gather_curves(tasks, data / "train")
        curves_csv = curves.to_csv(index=False, lineterminator="\n")
        store.write_text(folder.new / "curves.csv", curves_csv)

        findings = sentences.write_sentences(values, absent)
        if load_section(Ingest, params).source == "sample":
            findings.append(RENDERED)
        text = "\n\n".join(fill(sentence, 110) for sentence in findings)
        sections = [tables.results_table(values, task.name) for task in tasks]
        sections += [tables.claims_table(values, task.name) for task in tasks]
        sections += [tables.differences_table(values, task.name) for task in tasks]
        for task in tasks:
            sections += tables.nmse_tables(values, task.name)
        sections += [tables.models_table(tasks), *scores_tables(scores)]
        parts = [section.markdown() for section in sections if section.table.size]
        table = "\n\n".join([text, *parts])
        table = f"{table}\n\n{write_definitions(table)}"
        store.write_text(folder.new / "table.md", table.lstrip())

        figures = folder.new / "figures"
        figures.mkdir()  # DVC expects each output, even an empty one
        bend = None
        for task in tasks[:1]:
            bend = drawings.draw_bend(figures, task, values.loc[task.name], data)
        details = page.list_details(figures, values, tasks, data)
        details["Depth, classes and motion"] = scores_tables(scores)
        lines = [facts["line"] for facts in scores.get("recorded", {}).values()]
        notes, doubts = split_doubts(lines)
        details["Notes"] = [*encoder.get("sources", []), *notes]
        run = read_run()
        origin = describe_origin()
        if "started_s" in run:
            origin["duration"] = format_duration(run)
        doubts += sentences.unmeasured_drives(tasks)
        doubts += sentences.few_turns(values)
        doubts += sentences.few_drives(values)
        content = page.Page(
            sentences=findings,
            doubts=doubts,
            picture=bend,
            results=page.list_results(figures, values, tasks),
            details=details,
            origin=origin,
            settings=run.get("settings", {}),
        )
        words = define_words(page.text_of(content))
        details["Definitions"] = [f"{word}: {meaning}" for word, meaning in words.items()]
        page.write_page(folder.new / "index.html", content)
    print(text, f"Tables: {out.absolute()}/table.md. Page: {out.absolute()}/index.html", sep="\n")
    return out


def _read_json(path: Path, stage: str) -> dict[str, Any]:
    """Return the content of a file by a stage, or an empty one if there is no file."""
    return store.read_json(path, stage=stage) if path.is_file() else {}


if __name__ == "__main__":
    console.run(main)
