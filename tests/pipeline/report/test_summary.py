"""Test the figures of a run, and the kinds of its frames."""

from dataclasses import replace

import numpy as np

from pipeline.report import summary
from tests.pipeline.report import examples


def test_figures_are_errors_differences_and_validation_errors(tmp_path):
    scene = examples.metrics("path", [0.2, 0.4], predict="path") | {"drives": {"train": ["a"] * 3}}
    nmse = zip(scene["columns"], (0.1, 0.3), strict=True)
    scene["val"] = {column: {"nmse": value, "nmse_by_seed": [value]} for column, value in nmse}
    scene["val"]["a straight range"] = {"nmse": None, "nmse_by_seed": [None]}
    blind = examples.metrics("path-blind", 0.9, predict="path")
    figures = summary.results(examples.groups(tmp_path, scene, blind))
    assert {"figure": 0.3, "frames": 44, "seeds": [0.3]}.items() <= figures["path-0/5-10 m/path"].items()
    assert figures["path-0/5-10 m/path - path-blind"]["figure"] == -0.6
    assert {"figure": 0.2, "seeds": [0.2], "roads": 3}.items() <= figures["val/path"].items()


def test_kinds_of_frames_by_the_true_path(tmp_path):
    """In 1/m, for 0 to 5, 10 to 20, and 30 to 40 m; a bend that begins behind 30 m is none yet."""
    (group,) = examples.groups(tmp_path, examples.metrics("path", predict="path"))
    truth = {
        "straight": [0.001, -0.002, 0.0],
        "straight, far": [0.0, 0.0, 0.1],
        "approach, bends, winding": [0.0, -0.02, 0.0],
        "inside, bends, winding": [0.02, 0.03, 0.0],
        "inside, junctions, winding": [0.02, 0.06, np.nan],
        "junctions, leaving, winding": [-0.05, 0.0, np.nan],
    }
    labels = dict(zip("abc", ("0-5 m", "10-20 m", "30-40 m"), strict=True))
    kinds = summary.frame_kinds(replace(group, labels=labels, truth=np.array([*truth.values()])))
    for row, names in enumerate(truth):
        expected = sorted(set(names.split(", ")) - {"far"})
        assert sorted(kind for kind, mask in kinds.items() if mask[row]) == expected
