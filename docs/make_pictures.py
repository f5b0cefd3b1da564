"""Draw the README's picture from the output of `make demo`: python docs/make_pictures.py [DRIVE FRAME]."""

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera import classes
from pipeline.graphs import cloud, graph
from pipeline.report import street_view

DATA, DOCS = Path("data"), Path(__file__).resolve().parent
MODEL = "sa-gnn-ncp"


def main(drive: str = "2026_01_03_drive_0001", number: int = 60) -> None:
    """Draw the steps of the chain for one frame."""
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    panels = figure.subplot_mosaic("aabbcc;ddeeff", height_ratios=[1, 2.2])
    with (
        store.DriveReader(DATA / f"ingest/{drive}.h5", stage="ingest") as raw,
        store.DriveReader(DATA / f"perception/{drive}.h5", stage="perception") as perceived,
        store.DriveReader(DATA / f"clouds/pseudo/{drive}.h5", stage="clouds") as file,
    ):
        view = street_view.read_view(raw, perceived, file, number)
    panels["a"].imshow(view.rgb)
    street_view.draw_depth(panels["b"], view.depth_m)
    panels["c"].imshow(classes.colourise(view.cls))
    for key, title in zip("abc", ("image", "depth from the image", "classes, same forward pass"), strict=True):
        panels[key].set_title(title)
        panels[key].set_axis_off()

    xyz, cls = view.xyz, view.points_cls
    street_view.draw_cloud(panels["d"], xyz, cls)
    panels["d"].set_title(f"semantic cloud from above: {len(xyz):,} points")
    chosen = cloud.sample(len(xyz), 300, np.random.default_rng(0))
    pruned = graph.build(xyz[chosen], cls[chosen], 6, 0.2, np.random.default_rng(0))
    _draw_graph(panels["e"], xyz[chosen], classes.colourise(cls[chosen]) / 255, pruned)
    panels["e"].set_title(f"300 points of it: {pruned.edges_knn:,} kNN edges pruned to {pruned.edges_kept:,}")
    street_view.look_from_above(panels["e"])
    _draw_steering(panels["f"], drive, number)
    figure.savefig(DOCS / "chain.png", dpi=85, metadata={"Software": None})


def _draw_graph(panel: Axes, xyz: np.ndarray, colour: np.ndarray, pruned: graph.Graph) -> None:
    source = np.repeat(np.arange(len(pruned.degree)), pruned.degree)
    ends = xyz[:, [0, 2]]
    panel.add_collection(
        LineCollection(np.stack([ends[source], ends[pruned.indices]], axis=1), colors="0.6", linewidths=0.5)
    )
    panel.scatter(*ends.T, s=12, c=colour, linewidths=0, zorder=2)


def _draw_steering(panel: Axes, drive: str, number: int) -> None:
    with (DATA / f"evaluate/{MODEL}/predictions.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["drive"] == drive and row["predicted_rad"]]
    frame = np.array([int(row["frame"]) for row in rows])
    for key, colour, label in (("steering_rad", "tab:red", "driven"), ("predicted_rad", "tab:green", "predicted")):
        panel.plot(frame, np.rad2deg([float(row[key]) for row in rows]), color=colour, label=label)
    panel.axvline(number, color="0.7", linewidth=1)
    panel.set(xlabel="frame of the test drive", ylabel="steering in deg, left +", title="steering from 8 graphs")
    panel.margins(x=0)
    panel.legend(frameon=False)


if __name__ == "__main__":
    main(*sys.argv[1:2], *map(int, sys.argv[2:3]))
