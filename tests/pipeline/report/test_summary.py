"""Test the figures of a run."""

from pipeline.report import summary
from tests.pipeline.report import examples


def test_figures_are_errors_differences_and_validation_errors(tmp_path):
    scene = examples.metrics("path", [0.2, 0.4], predict="path") | {"drives": {"train": ["a"] * 3}}
    nmse = zip(scene["columns"], (0.1, 0.3), strict=True)
    scene["val"] = {column: {"nmse": value, "nmse_by_seed": [value]} for column, value in nmse}
    scene["val"]["a straight range"] = {"nmse": None, "nmse_by_seed": [None]}
    blind = examples.metrics("path-blind", 0.9, predict="path")
    figures = summary.rounded(summary.results(examples.groups(tmp_path, scene, blind)))
    assert {"figure": 0.3, "frames": 44, "seeds": [0.3]}.items() <= figures[
        "path-0/5-10 m/path"
    ].items()
    assert figures["path-0/5-10 m/path - path-blind"]["figure"] == -0.6
    assert {"figure": 0.2, "seeds": [0.2], "roads": 3}.items() <= figures["val/path"].items()
