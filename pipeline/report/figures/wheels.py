"""Draw frames of four kinds of bend with predicted and true steering wheel (Figure 4)."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, ConnectionStyle, FancyArrowPatch

from pipeline.report.drawing import save_png_and_svg

PREDICTED, TRUE = "tab:green", "tab:red"
GEAR = 3  # angle of the drawn wheel / angle of the front wheels: 5° would hardly be visible
SLIGHT = 0.3  # share of the sharpest right bend


class Example(NamedTuple):
    """A frame with its image uint8 [H,W,3] and both angles in degrees, left +."""

    title: str
    image: np.ndarray
    predicted_deg: float
    true_deg: float


def choose(predicted_deg: np.ndarray) -> dict[str, int]:
    """Return kind of bend → row of predicted angles [F]: sharpest left, slight and sharpest right, straightest.

    The slight one is nearest to SLIGHT times the sharpest right one. Kinds that were never predicted are left out.
    """
    if np.isnan(predicted_deg).all():
        return {}
    left, right = int(np.nanargmax(predicted_deg)), int(np.nanargmin(predicted_deg))
    kinds = {"left": left} if predicted_deg[left] > 0 else {}
    if predicted_deg[right] < 0:
        kinds["slight right"] = int(np.nanargmin(np.abs(predicted_deg - SLIGHT * predicted_deg[right])))
        kinds["sharp right"] = right
    return {**kinds, "straight": int(np.nanargmin(np.abs(predicted_deg)))}


def draw(path: Path, model: str, frames: Sequence[Example]) -> None:
    """Draw frames side by side, each above two wheels: predicted (green box) and true (red box)."""
    figure = Figure(figsize=(4.4 * len(frames), 4.0), layout="constrained")
    grid = figure.add_gridspec(2, 2 * len(frames), height_ratios=[1.15, 1])
    for column, example in enumerate(frames):
        street = figure.add_subplot(grid[0, 2 * column : 2 * column + 2])
        street.imshow(example.image)
        street.set_title(example.title, fontsize="small", loc="left")
        street.set_axis_off()
        for side, (name, angle, colour) in enumerate(
            (("predicted", example.predicted_deg, PREDICTED), ("driven", example.true_deg, TRUE))
        ):
            _wheel(figure.add_subplot(grid[1, 2 * column + side]), name, angle, colour)
    figure.suptitle(f"{model}: the wheel turns {GEAR} times the angle of the front wheels", fontsize="medium")
    save_png_and_svg(figure, path)


def _wheel(panel: Axes, name: str, angle_deg: float, colour: str) -> None:
    turned = np.deg2rad(GEAR * angle_deg)  # left is counterclockwise for the driver
    panel.add_patch(Circle((0, 0), 1, fill=False, linewidth=5, edgecolor="0.2"))
    panel.add_patch(Circle((0, 0), 0.16, color="0.2"))
    for spoke in (0, np.pi, 1.5 * np.pi):
        panel.plot([0, np.cos(spoke + turned)], [0, np.sin(spoke + turned)], color="0.2", linewidth=4)
    panel.plot([0, 0], [-1.25, 1.25], linestyle="--", color="0.55", linewidth=1)  # straight ahead
    top = np.pi / 2
    panel.plot([0, np.cos(top + turned)], [0, np.sin(top + turned)], color=colour, linewidth=2)
    if abs(turned) > 0.02:
        ends = [(1.15 * np.cos(at), 1.15 * np.sin(at)) for at in (top, top + turned)]
        bend = ConnectionStyle.Arc3(rad=float(np.tan(turned / 4)))
        panel.add_patch(FancyArrowPatch(*ends, connectionstyle=bend, arrowstyle="-|>", mutation_scale=12, color=colour))
    panel.set(xlim=(-1.5, 1.5), ylim=(-1.4, 1.4), aspect="equal", xticks=[], yticks=[])
    panel.set_title(f"{name} {round(angle_deg, 1) + 0.0:+.1f}°", fontsize="small", color=colour)
    for spine in panel.spines.values():
        spine.set(edgecolor=colour, linewidth=2)
