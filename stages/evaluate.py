"""Stage evaluate: predictions of a trained model and of baselines, and its errors on each split.

It writes data/evaluate/<model>/.
"""

from pathlib import Path

import numpy as np

from pipeline.jobs import console
from pipeline.jobs.console import EntryName
from pipeline.jobs.outputs import stage_folder

from pipeline.base import store
from pipeline.base.params import entry_name, load_section
from pipeline.evaluate import statistics
from pipeline.evaluate.error_table import common_frames, error_table, to_records
from pipeline.evaluate.predictions import (
    choose_training,
    fit_odometry,
    model_facts,
    predict_cases,
    prediction_table,
    read_drives,
)
from pipeline.evaluate.settings import PREDICTIONS, Evaluate
from pipeline.train import runs, trained


def main(
    name: EntryName = None,
    data: Path = Path("data"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Write metrics.json and predictions of validation and test drives. Return the model's folder.

    Errors are means over the seeds, in the frames that this model predicts. Stage report has those
    in the frames that all models predict.
    """
    name = entry_name(name)
    settings = load_section(Evaluate, params)
    train = data / "train" / name
    out = data / "evaluate" / name
    first = trained.load_model(train)
    with stage_folder(f"evaluate@{name}", out, params=params, chosen=first.entry.files) as folder:
        models = {
            run.seed: trained.load_model(run.folder) for run in runs.list_runs(train, first.seeds)
        }
        graphs = data / "graphs" / first.entry.input
        drives = read_drives(first, graphs, data / "labels", data / "motion")
        result = model_facts(name, first, drives)
        odometry_gain = fit_odometry(drives["train"], first.entry)
        tables = {}
        quantity = drives["test"][0].quantity
        # Eight training drives show whether a seed failed to train.
        predicted = drives | {"train": choose_training(drives["train"], first.entry.window)}
        for split, drives_of_split in predicted.items():
            result[split] = None
            if drives_of_split:
                cases = predict_cases(models, drives_of_split, odometry_gain)
                tables[split] = prediction_table(name, first.seeds, cases)
                predictions = common_frames({name: tables[split]}, quantity)
                methods = [name, "train_mean"] if split == "train" else [name]
                result[split] = to_records(error_table(predictions, methods, settings))
        result["frames"] = predictions.frames_text

        stuck = []
        if result["train"]:
            nmse = result["train"][name]["seeds"]
            # It is unknown if all these drives are straight, and 0 if all their values are equal.
            mean_nmse = result["train"]["train_mean"].get("nmse") or 1.0
            stuck = statistics.find_untrained(np.array(nmse, float), mean_nmse)
        result["untrained"] = [first.seeds[number] for number in stuck]
        for number in stuck:
            print(
                f"{name}: seed {first.seeds[number]} failed to train: nmse {nmse[number]:.3f} on "
                "training drives",
                flush=True,
            )
        store.write_json(folder.new / "metrics.json", result, sort_keys=False)
        for split, file in PREDICTIONS.items():
            if split in tables:
                text = tables[split].to_csv(index=False, lineterminator="\n", float_format="%.9f")
                store.write_text(folder.new / file, text)
    row = result["test"][f"{quantity.lead}/{name}" if quantity.lead else name]
    title = f"{quantity.measure.title} {quantity.lead}".strip()
    text = f"{statistics.error_text(row, quantity.measure)} {quantity.measure.unit}".strip()
    print(f"{name}: test {title} {text}, on the {row['frames']} frames that it predicts itself")
    return out


if __name__ == "__main__":
    console.run(main)
