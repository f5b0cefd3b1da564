"""Write predictions.csv, the steering of the test drives frame by frame, and structure.json, the graph of one frame."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.evaluate.split import Case
from pipeline.graphs import graph_file
from pipeline.train.labelled_drive import LabelledDrive
from pipeline.train.predict import Prediction

MAX_POINTS = 5000  # more points slow a browser down


def write_predictions(path: Path, cases: Sequence[Case], seed: int) -> None:
    """Write one row per frame with the predictions of seed number `seed`; missing angles are empty fields.

    `frame`, `time_s` and `speed_mps` are those of the last input frame, `onset` is 1 where a turn begins
    (decisions.py). `steering_rad` (true), `predicted_rad` and `valid` are those `horizon` frames later, and
    `odometry_rad` is the angle measured at the last input frame, which the baseline `odometry` predicts. Models with
    uncertainty have a last column `sigma_rad`, the standard deviation of the predicted angle.
    """
    write_columns(path, (_columns(case, case.predictions[seed]) for case in cases))


def write_columns(path: Path, drives: Iterable[Mapping[str, Iterable[Any]]]) -> None:
    """Write a CSV file from the columns of each drive, name → values."""
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        for number, columns in enumerate(drives):
            if not number:
                rows.writerow(columns)
            rows.writerows(zip(*columns.values(), strict=True))


def _columns(case: Case, predicted: Prediction) -> dict[str, Iterable[Any]]:
    drive = case.drive
    columns: dict[str, Iterable[Any]] = {
        "drive": [drive.name] * len(drive.frame),
        "frame": drive.frame,
        "time_s": text(drive.time_s, 6),
        "speed_mps": text(drive.speed_mps, 4),
        "steering_rad": text(drive.steering_rad, 9),
        "predicted_rad": text(predicted.steering_rad, 6),
        "valid": drive.valid.astype(int),
        "onset": case.onset.astype(int),
        # Of the first kind of motion in the graph file.
        "odometry_rad": text(next(iter(drive.measured_rad.values()), np.full(len(drive.frame), np.nan)), 6),
    }
    if predicted.sigma_rad is not None:
        columns["sigma_rad"] = text(predicted.sigma_rad, 6)
    return columns


def text(values: np.ndarray, digits: int) -> Iterator[str]:
    """Return numbers with `digits` decimals, NaN as an empty text."""
    return ("" if np.isnan(value) else f"{value:.{digits}f}" for value in values)


def write_structure(path: Path, drives: Sequence[LabelledDrive]) -> None:
    """Write drive → frame, points, xyz_m [[x,y,z],…], cls [P], edges [[a,b],…] with a < b, where the drive bends most.

    Only kNN graphs are written. Points beyond the nearest MAX_POINTS are left out; `points` counts all.
    """
    written = {}
    for drive in drives:
        with graph_file.open_graphs(drive.graphs) as graphs:
            if graphs.contents.kind == "graph" and len(drive.frame):
                bend = np.where(drive.valid, np.abs(np.nan_to_num(drive.steering_rad)), -1.0)
                written[drive.name] = _graph(graphs, int(bend.argmax()))
    store.write_json(path, written)


def _graph(graphs: graph_file.Graphs, row: int) -> dict[str, Any]:
    xyz, cls, edges = graphs.graph(row)
    nearest = np.sort(np.argsort(np.linalg.norm(xyz, axis=1), kind="stable")[:MAX_POINTS])
    number = np.full(len(xyz), -1)
    number[nearest] = np.arange(len(nearest))
    edges = number[edges]  # `nearest` is ascending, so the smaller end stays first
    edges = edges[(edges >= 0).all(axis=1)]
    return {
        "frame": int(graphs.frame[row]),
        "points": len(xyz),
        "xyz_m": [[round(float(value), 3) for value in point] for point in xyz[nearest]],
        "cls": cls[nearest].tolist(),
        "edges": edges.tolist(),
    }
