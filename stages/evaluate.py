"""Stage evaluate: errors of a trained model and of baselines on each split.

It writes data/evaluate/<model>/.
"""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import entry_name, load
from pipeline.evaluate.cases import (
    evaluate_model,
    predict_cases,
    summary,
    train_nmse,
    write_predictions,
)
from pipeline.evaluate.settings import Evaluate
from pipeline.train import runs, trained

ModelName = Annotated[
    str | None,
    typer.Argument(metavar="MODEL", help="an entry of models in the params file; default: DVC's"),
]


def main(
    name: ModelName = None,
    data: Path = Path("data"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json and, for the test drives, predictions.csv. Return the model's folder.

    Metrics are means over the seeds and ignore invalid frames.
    """
    name = entry_name(name)
    settings = load(Evaluate, params)
    train = data / "train" / name
    out = data / "evaluate" / name
    first = trained.load_model(train)
    with stage_folder(f"evaluate@{name}", out, params=params, chosen=first.entry.files) as folder:
        models = {run.seed: trained.load_model(run.folder) for run in runs.runs(train, first.seeds)}
        cases = predict_cases(models, data / "graphs" / first.entry.input, data / "labels")
        result = evaluate_model(name, first, cases, settings)
        for seed in result["untrained"]:
            error = train_nmse(result)[first.seeds.index(seed)]
            print(
                f"{name}: seed {seed} failed to train: nmse {error:.3f} on its own training drives",
                flush=True,
            )
        store.write_json(folder.new / "metrics.json", result, sort_keys=False)
        write_predictions(folder.new / "predictions.csv", name, first.seeds, cases["test"])
    print(f"{name}: test nmse {', '.join(summary(*column) for column in result['test'].items())}")
    return out


if __name__ == "__main__":
    console.run(main)
