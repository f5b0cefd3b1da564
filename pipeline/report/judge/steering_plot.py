"""A diagram of what a model predicts. Files are byte-identical for identical input."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.base.atomic import replacing
from pipeline.train.windows import Drive


def draw(path: Path, predictions: Sequence[tuple[Drive, np.ndarray]], title: str) -> None:
    """Draw true and predicted steering [G] rad over time, a panel per drive; grey where there is no valid target.

    Beside them the angle of odometry, of the first kind of motion that the drive's graphs carry.
    Time is that of the last frame seen; with a horizon, both angles are those so many frames later.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 0.6 + 2.4 * len(predictions)), layout="constrained")
    panels = figure.subplots(len(predictions), squeeze=False)[:, 0]
    for panel, (drive, predicted) in zip(panels, predictions, strict=True):
        truth = np.rad2deg(np.where(drive.valid, drive.steering_rad, np.nan))
        panel.axhline(0, color="0.85", linewidth=0.8)
        panel.plot(drive.time_s, truth, color="tab:red", label="driven (bicycle model)")
        for measured in [*drive.measured_rad.values()][:1]:
            panel.plot(drive.time_s, np.rad2deg(measured), color="tab:orange", linewidth=0.8, label="odometry")
        panel.plot(drive.time_s, np.rad2deg(predicted), color="tab:green", label="predicted")
        panel.fill_between(
            drive.time_s, 0, 1, where=~drive.valid, transform=panel.get_xaxis_transform(), color="0.93", linewidth=0
        )
        ahead = f"\n{drive.horizon} frames ahead" if drive.horizon else ""
        panel.set_ylabel(f"steering in deg, left +{ahead}")
        panel.set_title(drive.name, fontsize="small", loc="left")
        panel.margins(x=0)
    panels[0].legend(loc="upper right", frameon=False, ncols=3)
    panels[-1].set_xlabel("time in s")
    figure.suptitle(title)
    with replacing(path) as tmp:
        figure.savefig(tmp, dpi=90, metadata={"Software": None})
