"""Write predictions.csv, the columns of the test drives frame by frame, and structure.json, the graph of one frame."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base import store
from pipeline.base.atomic import replacing
from pipeline.evaluate.metrics import Case
from pipeline.graphs import graph_file
from pipeline.train.labelled_drive import LabelledDrive

MAX_POINTS = 5000  # more points slow a browser down


def write_predictions(path: Path, cases: Sequence[Case], seed: int) -> None:
    """Write one row per frame with the predictions of seed number `seed`; unknown values are empty fields.

    `frame`, `time_s` and `speed_mps` are those of the last input frame, `onset` is 1 where a turn begins
    (decisions.py). For each column C of the model, `true_C` and `predicted_C` are those `horizon` frames later,
    `odometry_C` is measured at the last input frame, and models with uncertainty have `sigma_C`.
    """
    with replacing(path) as tmp, tmp.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        for number, case in enumerate(cases):
            columns = _columns(case, seed)
            if not number:
                rows.writerow(columns)
            rows.writerows(zip(*columns.values(), strict=True))


def _columns(case: Case, seed: int) -> dict[str, Iterable[Any]]:
    drive, predicted = case.drive, case.predictions[seed]
    columns: dict[str, Iterable[Any]] = {
        "drive": [drive.name] * len(drive.frame),
        "frame": drive.frame,
        "time_s": _text(drive.time_s, 6),
        "speed_mps": _text(drive.speed_mps, 4),
        "onset": np.isin(drive.frame, case.turns.frame).astype(int),
    }
    odometry = np.full_like(drive.truth, np.nan) if drive.odometry is None else drive.odometry
    for number, name in enumerate(drive.columns):
        columns[f"true_{name}"] = _text(drive.truth[:, number], 9)
        columns[f"predicted_{name}"] = _text(predicted.mean[:, number], 6)
        columns[f"odometry_{name}"] = _text(odometry[:, number], 6)
        if predicted.sigma is not None:
            columns[f"sigma_{name}"] = _text(predicted.sigma[:, number], 6)
    return columns


def _text(values: np.ndarray, digits: int) -> Iterator[str]:
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
                bend = np.where(drive.valid, np.abs(drive.target), -1.0).max(axis=1)
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
