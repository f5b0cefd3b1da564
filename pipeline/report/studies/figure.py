"""The figure of a study. Files are byte-identical for identical input."""

from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.report.studies.study import Points, Study, validation_nmse


def draw(path: Path, study: Study, points: Points) -> None:
    """Draw test nmse over the study's values, its spread over seeds, its interval, and the measured angle's nmse."""
    from matplotlib.figure import Figure

    values = [value for value, _ in points]
    tests = [result["test"] for _, result in points]
    figure = Figure(figsize=(5, 3.4), layout="constrained")
    axes = figure.subplots()
    low, high = np.array([test["nmse_ci95"] for test in tests]).T
    axes.fill_between(values, low, high, color="tab:blue", alpha=0.15, linewidth=0, label="95 % interval, other roads")
    spread = [test["nmse_std"] or 0.0 for test in tests]
    nmse = [test["nmse"] for test in tests]
    axes.errorbar(values, nmse, spread, marker="o", capsize=3, color="tab:blue", label="test, ± between seeds")
    lines = {"validation": (":", "tab:blue", [validation_nmse(result) for _, result in points])}
    for baseline, colour in (("odometry", "tab:orange"), ("persistence", "tab:green")):
        lines[baseline] = ("--", colour, [test["baselines"].get(baseline, {}).get("nmse") for test in tests])
    for label, (style, colour, line) in lines.items():
        if any(height is not None for height in line):
            axes.plot(values, np.array(line, float), style, color=colour, linewidth=1, label=label)
    if study.logarithmic:
        axes.set_xscale("log")
        axes.set_xticks(values, [f"{value:g}" for value in values])
        axes.minorticks_off()
    axes.set_xlabel(study.label)
    axes.set_ylabel("nmse")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize="x-small")
    with replacing(path) as tmp:
        figure.savefig(tmp, dpi=110, metadata={"Software": None})
