"""Figure 5: where the car went, and where it would have gone, had it steered as models predict."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipeline.report.figures.drawing import save
from pipeline.report.judge.paths import Track, segments


def draw(path: Path, tracks: Mapping[str, Track], models: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Draw each drive's true path and those of models, model → drive → predicted rad [F]; dots are resets."""
    figure = Figure(figsize=(4.6 * len(tracks), 5.2), layout="constrained")
    panels = figure.subplots(1, len(tracks), squeeze=False)[0]
    for panel, (drive, track) in zip(panels, tracks.items(), strict=True):
        true = track.path(track.steering_rad, 0, len(track.time_s))
        panel.plot(-true[:, 1], true[:, 0], color="0.15", linewidth=3, label="driven")
        for number, (model, of_drives) in enumerate(models.items()):
            if drive not in of_drives:
                continue
            for first, last in segments(track, of_drives[drive]):
                own = track.path(of_drives[drive], first, last)
                panel.plot(-own[:, 1], own[:, 0], color=f"C{number}", linewidth=1.3, label=model)
                panel.plot(-own[0, 1], own[0, 0], ".", color=f"C{number}", markersize=6)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(drive, fontsize="small", loc="left")
        panel.set_xlabel("right of the start in m")
    panels[0].set_ylabel("ahead of the start in m")
    named = {text: line for line, text in zip(*panels[0].get_legend_handles_labels(), strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=6, frameon=False)
    save(figure, path)
