"""Stage scores: errors of depth, classes and measured motion against what the drives recorded."""

from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.base.params import load_section
from pipeline.labels.label import Car
from pipeline.labels.settings import Labels
from pipeline.scores.score import score_drive, score_splits


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Write metrics.json with the scores of validation and test drives. Return the output folder.

    Each of these drives has a <drive>/metrics.json, too, with depth and classes only. The scores of
    training drives are None. data/README.md explains the keys ``motion`` and ``recorded``. Angles
    and valid frames are defined as in the labels.
    """
    labels = load_section(Labels, params)
    car = Car(labels.wheelbase_m, labels.min_speed_mps)
    out = data / "scores"
    inputs = {name: data / name for name in ("ingest", "perception")}
    splits = store.read_index(inputs["perception"], stage="perception")

    scored = [drive for drive, split in splits.items() if split != "train"]
    jobs = file_jobs(scored, inputs, score_drive, target="{}/metrics.json")
    with stage_folder("scores", out, params=params) as folder:
        summaries = make_drives(folder, jobs, {}, log_format="{frames} frames")
        content = score_splits(splits, summaries, data / "ingest", data / "motion", car)
        store.write_json(folder.new / "metrics.json", content)
    for facts in content["recorded"].values():
        print(facts["line"])
    return out


if __name__ == "__main__":
    console.run(main)
