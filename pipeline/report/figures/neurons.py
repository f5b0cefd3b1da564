"""Draw the wiring of a neural circuit policy, and the states of its neurons in a bend."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.drawing import save_png_and_svg

EXCITES, INHIBITS = "tab:blue", "tab:red"


def draw(path: Path, model: str, neurons: Mapping[str, Any]) -> None:
    """Draw the content of neurons.json: synapses on the left, steering and states over the frames on the right."""
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.1, 1])
    left, right = (figure.add_subfigure(grid[column]) for column in (0, 1))
    layers = _layers(neurons["wiring"])
    _draw_wiring(left.subplots(), neurons["wiring"], layers)
    street, heat = right.subplots(2, 1, sharex=True, height_ratios=[1, 3])
    frame, steering = neurons["frame"], np.array(neurons["steering_rad"], float)
    street.plot(frame, np.rad2deg(steering), color="0.15")
    street.set(ylabel="driven, deg, left +", title=f"{neurons['drive']}: the neurons of {model}")
    states = np.array(neurons["activity"])  # [F,U]
    rows = [number for numbers in layers.values() for number in numbers if number < states.shape[1]]
    limit = float(np.abs(states).max(initial=1e-6))
    extent = (frame[0] - 0.5, frame[-1] + 0.5, len(rows) - 0.5, -0.5)
    style = {"aspect": "auto", "cmap": "RdBu_r", "interpolation": "nearest", "extent": extent}
    image = heat.imshow(states.T[rows], vmin=-limit, vmax=limit, **style)
    middle = [np.mean([rows.index(number) for number in numbers if number in rows]) for numbers in layers.values()]
    heat.set(xlabel="KITTI frame", yticks=middle, yticklabels=[*layers])
    right.colorbar(image, ax=heat, label="state")
    save_png_and_svg(figure, path)


def _layers(wiring: Mapping[str, Any]) -> dict[str, range]:
    """Return layer → neuron numbers, in the order of the signal; neurons are numbered the other way round."""
    motor, command, inter = (wiring[name] for name in ("motor", "command", "inter"))
    return {
        "inter": range(motor + command, motor + command + inter),
        "command": range(motor, motor + command),
        "motor": range(motor),
    }


def _draw_wiring(panel: Axes, wiring: Mapping[str, Any], layers: Mapping[str, range]) -> None:
    features = range(1 + max((source for source, _, _ in wiring["sensory"]), default=-1))
    columns = {"sensory": {number: (0.0, _height(number, len(features))) for number in features}, "internal": {}}
    for column, numbers in enumerate(layers.values(), start=1):
        for row, number in enumerate(numbers):
            columns["internal"][number] = (float(column), _height(row, len(numbers)))
    for kind, opacity in (("sensory", 0.35), ("internal", 0.9)):
        for source, target, sign in wiring[kind]:
            start, end = columns[kind][source], columns["internal"][target]
            arrow = {
                "arrowstyle": "-|>", "color": EXCITES if sign > 0 else INHIBITS, "alpha": opacity, "linewidth": 0.8,
                "connectionstyle": "arc3,rad=0.5" if start[0] == end[0] else "arc3", "shrinkA": 5, "shrinkB": 6,
            }  # fmt: skip
            panel.annotate("", end, start, arrowprops=arrow)
    panel.plot(*zip(*columns["sensory"].values(), strict=True), "o", color="0.35", markersize=4)
    panel.plot(*zip(*columns["internal"].values(), strict=True), "o", color="0.1", markersize=9)
    panel.set(xlim=(-0.3, 3.3), ylim=(-0.08, 1.08), yticks=[], xticks=range(4), frame_on=False)
    names = [f"{len(features)} features", *(f"{len(numbers)} {name}" for name, numbers in layers.items())]
    panel.set_xticklabels(names)
    panel.set_title("synapses: blue excites, red inhibits", fontsize="medium")


def _height(row: int, count: int) -> float:
    return 0.5 if count == 1 else 1 - row / (count - 1)
