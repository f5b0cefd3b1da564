"""Draw driven paths and the paths of predicted steering (the paper's Figure 5)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.report.drawing import save_png_and_svg
from pipeline.report.judge.paths import Track, segments

_MAX_COLUMNS = 4  # panels side by side


def draw(path: Path, tracks: Mapping[str, Track], models: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Draw the path of each drive and those of models: model → drive → predicted rad [F]. Dots are restarts."""
    rows = -(-len(tracks) // _MAX_COLUMNS)
    columns = -(-len(tracks) // rows)
    figure = Figure(figsize=(4.0 * columns, 4.2 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(tracks) :]:
        panel.set_axis_off()
    for panel, (drive, track) in zip(panels, tracks.items(), strict=False):
        true = track.path(track.steering_rad, 0, len(track.time_s))
        panel.plot(-true[:, 1], true[:, 0], color="0.15", linewidth=3, label="driven")
        for number, (model, predicted) in enumerate(models.items()):
            for first, last in segments(track, predicted[drive]) if drive in predicted else ():
                piece = track.path(predicted[drive], first, last)
                panel.plot(-piece[:, 1], piece[:, 0], color=f"C{number}", linewidth=1.3, label=model)
                panel.plot(-piece[0, 1], piece[0, 0], ".", color=f"C{number}", markersize=6)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(drive, fontsize="small", loc="left")
        panel.set(xlabel="right of the start in m", ylabel="ahead of the start in m")
    labels = {text: line for panel in panels for line, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=6, frameon=False)
    save_png_and_svg(figure, path)
