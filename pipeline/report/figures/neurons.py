"""The wiring of a neural circuit policy, and what its neurons do in a bend."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.report.figures.drawing import save

LAYERS = ("inter", "command", "motor")  # as signals go; numbered the other way round
EXCITES, INHIBITS = "tab:blue", "tab:red"


def draw(path: Path, model: str, neurons: Mapping[str, Any]) -> None:
    """Draw what neurons.json holds: synapses on the left, on the right steering and activity over the frames."""
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.1, 1])
    left, right = (figure.add_subfigure(grid[column]) for column in (0, 1))
    _draw_wiring(left.subplots(), neurons["wiring"])
    street, heat = right.subplots(2, 1, sharex=True, height_ratios=[1, 3])
    frame, steering = neurons["frame"], np.array(neurons["steering_rad"], float)
    street.plot(frame, np.rad2deg(steering), color="0.15")
    street.set(ylabel="driven, deg, left +", title=f"{neurons['drive']}: the neurons of {model}")
    activity = np.array(neurons["activity"])  # [F,U]
    reach = float(np.abs(activity).max(initial=1e-6))
    order, edges = _order(neurons["wiring"], activity.shape[1])
    shown = heat.imshow(
        activity.T[order], aspect="auto", cmap="RdBu_r", vmin=-reach, vmax=reach, interpolation="nearest",
        extent=(frame[0] - 0.5, frame[-1] + 0.5, len(order) - 0.5, -0.5),
    )  # fmt: skip
    heat.set(xlabel="KITTI frame", yticks=[middle for _, middle in edges], yticklabels=[name for name, _ in edges])
    right.colorbar(shown, ax=heat, label="state")
    save(figure, path)


def _order(wiring: Mapping[str, Any], units: int) -> tuple[list[int], list[tuple[str, float]]]:
    """Return the neurons as signals go, and the layers' names with the rows in their middle."""
    first = {"motor": 0, "command": wiring["motor"], "inter": wiring["motor"] + wiring["command"]}
    rows: list[int] = []
    names = []
    for layer in LAYERS:
        own = [number for number in range(first[layer], first[layer] + wiring[layer]) if number < units]
        names.append((layer, len(rows) + (len(own) - 1) / 2))
        rows += own
    return rows, names


def _draw_wiring(panel: Axes, wiring: Mapping[str, Any]) -> None:
    heard = 1 + max((source for source, _, _ in wiring["sensory"]), default=-1)
    place = {("sensory", number): (0.0, _height(number, heard)) for number in range(heard)}
    first = {"motor": 0, "command": wiring["motor"], "inter": wiring["motor"] + wiring["command"]}
    for column, layer in enumerate(LAYERS, start=1):
        for number in range(wiring[layer]):
            place["internal", first[layer] + number] = (float(column), _height(number, wiring[layer]))
    for kind, strength in (("sensory", 0.35), ("internal", 0.9)):
        for source, target, sign in wiring[kind]:
            start, end = place[kind, source], place["internal", target]
            loop = "arc3,rad=0.5" if start[0] == end[0] else "arc3"
            panel.annotate(
                "", end, start,
                arrowprops={"arrowstyle": "-|>", "color": EXCITES if sign > 0 else INHIBITS, "alpha": strength,
                            "linewidth": 0.8, "connectionstyle": loop, "shrinkA": 5, "shrinkB": 6},
            )  # fmt: skip
    for (kind, _), (x, y) in place.items():
        panel.plot(x, y, "o", color="0.35" if kind == "sensory" else "0.1", markersize=4 if kind == "sensory" else 9)
    panel.set(xlim=(-0.3, 3.3), ylim=(-0.08, 1.08), yticks=[], xticks=range(4))
    panel.set_xticklabels([f"{heard} features", *(f"{wiring[layer]} {layer}" for layer in LAYERS)])
    panel.set_title("synapses: blue excites, red inhibits", fontsize="medium")
    for spine in panel.spines.values():
        spine.set_visible(False)


def _height(number: int, count: int) -> float:
    return 0.5 if count == 1 else 1 - number / (count - 1)
