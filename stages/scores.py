"""Stage scores: errors of depth, classes and measured motion against what the drives recorded."""

from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import console, store
from pipeline.base.outputs import stage_folder
from pipeline.base.params import SPLITS, load
from pipeline.base.runner import Summary, file_jobs, make_drives
from pipeline.camera.camera import read_camera
from pipeline.camera.images import to_metres
from pipeline.ingest.truth import read_truth
from pipeline.labels import comparison
from pipeline.labels import source as sources
from pipeline.labels.agreement import compare
from pipeline.labels.label import Car
from pipeline.labels.settings import SOURCES, Labels
from pipeline.scores.pixels import Scores


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Write metrics.json with the scores of validation and test drives, and <drive>/metrics.json of each of them.

    The scores of training drives are None. Keys ``motion`` and ``recorded``: see data/README.md; angles and valid
    frames are defined as in the labels. Returns the output folder.
    """
    labels, out = load(Labels, params), data / "scores"
    ingest, perception, motion = (data / name for name in ("ingest", "perception", "motion"))
    car = Car(labels.wheelbase_m, labels.min_speed_mps)
    index = store.read_index(perception, stage="perception")
    splits = {drive: split for drive, split in index.items() if split != "train"}
    inputs = {"ingest": ingest, "perception": perception, "motion": motion}
    jobs = file_jobs(splits, inputs, partial(_score_drive, car=car), "{}/metrics.json")
    with stage_folder("scores", out) as folder:
        summaries = make_drives(folder, jobs, car._asdict(), "{frames} frames")
        content: dict[str, Any] = {"motion": {}, "recorded": {}, "train": Scores().report()}
        for split in ("val", "test"):
            scores, drives = Scores(), store.drives_in(splits, split)
            for drive in drives:
                scores.add(summaries[drive]["sums"])
            content[split] = scores.report()
            for kind, motion_scores in _score_motion(drives, ingest, motion, car).items():
                content["motion"].setdefault(kind, dict.fromkeys(SPLITS))[split] = motion_scores
        for kind in (name for name in SOURCES if not sources.load(name).MEASURED):
            pairs = comparison.read(kind, store.drives_in(index, "train", "val") or [*index], ingest, motion, car)
            errors, lines = comparison.judge(compare([*pairs.values()]), sources.column(kind))
            content["recorded"][kind] = {"lines": [*lines, *errors]}
        store.write_json(folder.new / "metrics.json", content)
    return out


def _score_drive(path: Path, *, ingest: Path, perception: Path, motion: Path, car: Car) -> Summary:
    scores = Scores()
    with (
        store.DriveReader(ingest, stage="ingest") as source,
        store.DriveReader(perception, stage="perception") as perceived,
    ):
        camera = read_camera(source)
        for row, number in enumerate(perceived.frame):
            depth_m, cls = to_metres(perceived.row("depth_m", row)), perceived.row("cls", row)
            scores.add_frame(depth_m, cls, camera, read_truth(source, camera, source.row_of(number)))
    of_motion = _score_motion([ingest.stem], ingest.parent, motion.parent, car)
    store.write_json(path, {**scores.report(), "motion": of_motion})
    return {"frames": len(perceived.frame), "sums": {key: sums.tolist() for key, sums in scores.sums.items()}}


def _score_motion(drives: list[str], ingest: Path, motion: Path, car: Car) -> dict[str, Any]:
    """Return scores of the measured motion that models get (visual), and of steering angles (wheel), against oxts.

    ``visual-wheel``: against steering angles. Only what the `drives` recorded is compared, possibly nothing.
    """
    errors: dict[str, list[np.ndarray]] = {}
    for drive in drives:
        with store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as raw:
            references, measured = sources.recorded(raw, car), motion / f"{drive}.h5"
            kinds = ("visual", *references)
            labels = {kind: sources.read(kind, raw, measured, car, look_ahead=False) for kind in kinds}
            with store.DriveReader(measured, stage="motion") as file:
                rows = {"visual": np.searchsorted(raw.frame, file.frame)}
            if "wheel" in references:
                rows["wheel"], unknown = np.flatnonzero(raw["has_steering"]), np.full(len(raw.frame), np.nan)
                # A wheel records no speed: these labels have the speed of another source.
                labels["wheel"] = labels["wheel"]._replace(speed_mps=unknown, yaw_rate_radps=unknown)
        for reference, kind in product(references, rows):
            if kind != reference:
                name = kind if reference == "oxts" else f"{kind}-{reference}"
                pair = labels[kind].at(rows[kind]), labels[reference].at(rows[kind])
                errors.setdefault(name, []).append(comparison.errors(*pair))
    return {kind: comparison.score(errors_of_kind) for kind, errors_of_kind in errors.items()}


if __name__ == "__main__":
    console.run(main)
