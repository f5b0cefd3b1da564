"""Draw docs/roads.png, the validation nmse over the number of training roads, from docs/roads.csv.

Each row of the CSV is one network: the error of the epoch that is kept, in data/train/MODEL/curve.csv of a run
of presets/roads.yaml with `models.MODEL.roads`.
"""

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from pipeline.report import street_view

DOCS = Path(__file__).parent
STEPS = 1200  # epochs × roads of the study; networks with more steps are single points
LINES = {  # model: label, colour, style
    "motion-10": ("a second ahead", "tab:blue", "-"),
    "motion-10-blind": ("… without the scene", "tab:blue", "--"),
    "path": ("path ahead, mean of the ranges to 30 m", "tab:green", "-"),
    "path-blind": ("… without the scene", "tab:green", "--"),
    "sa-gnn-ncp": ("current frame, without motion", "tab:red", "-"),
}


def main() -> None:
    """Draw a line per model through the means over seeds; stars are the networks of `make roads`, with more steps."""
    networks = pd.read_csv(DOCS / "roads.csv")
    figure = Figure(figsize=(7, 3), layout="constrained")
    axes = figure.subplots()
    for model, (label, colour, style) in LINES.items():
        rows = networks[networks["model"] == model]
        equal = rows["epochs"] * rows["roads"] == STEPS
        mean = rows[equal].groupby("roads")["val_nmse"].mean()
        axes.plot(mean.index, mean, style, marker="o", markersize=4, color=colour, label=label)
        longer = rows[~equal].groupby("roads")["val_nmse"].mean()
        axes.plot(longer.index, longer, "*", markersize=11, color=colour)
    axes.plot([], [], "k*", markersize=9, label="make roads: 12 epochs, three seeds")
    axes.set_xscale("log")
    roads = sorted(networks["roads"].unique())
    axes.set_xticks(roads, [str(number) for number in roads])
    axes.minorticks_off()
    axes.set(xlabel="training roads of 60 frames", ylabel="validation nmse", ylim=(0, None))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", frameon=False, fontsize="small")
    street_view.save(figure, DOCS / "roads.png", dpi=100)


if __name__ == "__main__":
    main()
