"""The studies of presets/studies.yaml, and which models are points of one.

A model of a study is called STUDY-VALUE; sa-gnn-ncp has the default of every study and is a point of each.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

Result = dict[str, Any]  # a model's metrics.json
Points = Sequence[tuple[float, Result]]  # of a study: value and model, by value
DEFAULT = "sa-gnn-ncp"


class Study(NamedTuple):
    """The axis of a figure, the default's place on it, and whether it is logarithmic."""

    label: str
    default: float
    logarithmic: bool = False


STUDIES = {
    "points": Study("points a frame", 1000, logarithmic=True),
    "k": Study("nearest neighbours of a point", 6),
    "keep": Study("edges between classes that are kept, %", 20),
    "lambda": Study("weight λ of the classes (eq. 7), %", 100),
    "window": Study("frames that a prediction sees", 8, logarithmic=True),
    "horizon": Study("frames ahead", 0),
    "roads": Study("training drives", 24, logarithmic=True),
}


def points(results: Sequence[Result]) -> dict[str, Points]:
    """Return study → its points, for those that have one beside the default."""
    by_name = {result["model"]: result for result in results}
    found = {name: _points(name, study, by_name) for name, study in STUDIES.items()}
    return {name: of_study for name, of_study in found.items() if len(of_study) > 1}


def _points(name: str, study: Study, results: Mapping[str, Result]) -> Points:
    if DEFAULT not in results:
        return []
    found = {study.default: results[DEFAULT]}
    for model, result in results.items():
        prefix, _, value = model.rpartition("-")
        if prefix == name and value.isdecimal():
            found[float(value)] = result
    return sorted(found.items())


def validation_nmse(result: Result) -> float | None:
    """Return a model's nmse on the validation drives; None where there are none."""
    return (result["val"] or {}).get("nmse")
