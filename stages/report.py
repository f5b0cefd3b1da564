"""Compare all models: data/report/{index.html, table.md, table.csv, metrics.json, …}."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.atomic import replacing, stage_folder, sweep
from pipeline.base.params import entries, load
from pipeline.settings.evaluate import Evaluate


def main(
    data: Annotated[Path, typer.Option(help="folder with the folders of all stages")] = Path("data"),
    out: Path = Path("data/report"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write tables, the page, the paper's figures, and the files of DVC's metrics and plots. Returns `out`.

    Models of the params file that are not evaluated on this machine are named with the command that gets them.
    """
    from pipeline.report import dvc_files, path_ahead, perception, tables
    from pipeline.report.figures import draw
    from pipeline.report.page import write_page
    from pipeline.report.results import load_results
    from pipeline.report.story import sentences

    models = entries("models", params)
    evaluated = [model for model in models if (data / "evaluate" / model / "metrics.json").is_file()]
    settings = load(Evaluate, params)
    paths = path_ahead.load_paths(data / "evaluate", path_ahead.path_models(data / "evaluate", evaluated))
    of_paths, path_tables = {model.metrics.model for model in paths}, path_ahead.tables(paths, settings)
    results = load_results(data / "evaluate", [model for model in evaluated if model not in of_paths])
    scores = perception.load_scores(data / "scores")
    steering = tables.steering_tables(results)
    perception_tables = perception.tables(scores) if scores else []
    absent = [model for model in models if model not in evaluated]
    parts = [*(table.markdown() for table in (*steering, *path_tables)), tables.missing(absent)]
    text = "\n\n".join(filter(None, [*parts, *(table.markdown() for table in perception_tables)]))
    with stage_folder(out):
        with replacing(out / "table.md") as unfinished:
            unfinished.write_text(f"{text}\n", encoding="utf-8")
        dvc_files.write_csv(out / "table.csv", tables.csv_rows(results.metrics), na="")
        store.write_json(out / "metrics.json", dvc_files.metrics(results, scores) | path_ahead.dvc_metrics(paths))
        for folder in ("learning", "steering", "figures"):  # DVC expects each output, even an empty one
            (out / folder).mkdir(exist_ok=True)
            sweep(out / folder)
        for model in evaluated:
            dvc_files.write_learning(data / "train" / model, out / "learning")
        dvc_files.write_steering(results.predictions, out / "steering")
        captions = draw(out / "figures", results, paths, data)
        story = sentences(results)
        write_page(out / "index.html", story, results, steering, path_tables, perception_tables, captions, data)
    print(text)
    return out


if __name__ == "__main__":
    console.run(main)
