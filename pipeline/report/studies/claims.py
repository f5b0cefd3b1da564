"""What the paper says that the studies bear on, judged by pairs of models on the same frames."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.report.judge.interval import difference_interval
from pipeline.report.studies.study import DEFAULT, Result
from pipeline.sections.evaluate import Evaluate

Angles = dict[tuple[str, int], tuple[float, float]]  # (drive, frame) → true and predicted steering in rad


class Claim(NamedTuple):
    """What the paper says, and the two models whose difference bears on it, the paper's side first."""

    text: str
    ours: str
    other: str


CLAIMS = (
    Claim("pruning: 20 % of the edges between classes kept, against all", DEFAULT, "keep-100"),
    Claim("semantics: λ = 1 against 0", DEFAULT, "lambda-0"),
    Claim("NCP against LSTM", DEFAULT, "lstm"),
)


def markdown(results: Sequence[Result], evaluate: Path, settings: Evaluate) -> list[str]:
    """Return a line for each claim whose models are among `results`, whose predictions lie in folder `evaluate`.

    A line has both errors, and the interval of their difference; without a claim there is none at all.
    """
    by_name = {result["model"]: result for result in results}
    lines = []
    for claim in CLAIMS:
        if claim.ours not in by_name or claim.other not in by_name:
            continue
        ours, other = by_name[claim.ours], by_name[claim.other]
        truth, drive, (angles, others) = _predictions(evaluate / claim.ours, evaluate / claim.other)
        draw = (settings.bootstrap_block_frames, settings.bootstrap_samples, settings.seed)
        low, high = difference_interval(truth, angles, others, drive, *draw)
        verdict = "better" if high < 0 else "worse" if low > 0 else "no difference shown"
        lines.append(
            f"- {claim.text}: {verdict}. nmse {ours['test']['nmse']:.3f} against {other['test']['nmse']:.3f}, "
            f"difference {low:+.3f} to {high:+.3f} (95 %); {ours['parameters']:,} parameters against "
            f"{other['parameters']:,}"
        )
    return ["## The paper's claims", "", *lines, ""] if lines else []


def _predictions(*models: Path) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return truth and drive number [N] of the frames where all networks predict, and each model's angles [S,N]."""
    tables = [[_read(path) for path in sorted(model.rglob("predictions.csv"))] for model in models]
    common = sorted(set.intersection(*(set(of_seed) for of_model in tables for of_seed in of_model)))
    names = sorted({drive for drive, _ in common})
    truth = np.array([tables[0][0][key][0] for key in common])
    drive = np.array([names.index(name) for name, _ in common])
    angles = [np.array([[of_seed[key][1] for key in common] for of_seed in of_model]) for of_model in tables]
    return truth, drive, angles


def _read(path: Path) -> Angles:
    """Return the angles of the frames that count."""
    with path.open(newline="", encoding="utf-8") as file:
        return {
            (row["drive"], int(row["frame"])): (float(row["steering_rad"]), float(row["predicted_rad"]))
            for row in csv.DictReader(file)
            if row["valid"] == "1" and row["predicted_rad"]
        }
