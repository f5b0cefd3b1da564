"""Draw the pictures of the page. They are readable on a screen of 400 pixels.

Charts are PNG files and photographs JPEG files, in the folder `folder`. A function returns None if
there is nothing to draw, for instance without images on this machine. `table` holds the values of
the task.
"""

import base64
from contextlib import ExitStack
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base.store import DriveReader
from pipeline.clouds.cloud_file import open_clouds
from pipeline.evaluate import statistics
from pipeline.evaluate.settings import BASELINES
from pipeline.graphs.graph_file import open_graphs
from pipeline.ingest.ingest_file import open_ingest
from pipeline.ingest.stored_camera import read_camera
from pipeline.perception.perception_file import open_perception
from pipeline.report import street_view
from pipeline.report.street_view import COLOURS, WIDTH, chart_colour
from pipeline.report.values import (
    Task,
    lead_errors,
    list_ends,
    list_methods,
    list_ranges,
    measure_of,
    rank_models,
    title_of,
    with_scene,
    without_scene,
)
from pipeline.train.quantity import Measure

# Colours of models that have none in COLOURS. They repeat if there are more models.
OTHERS = ("#8a5fbf", "#7a6a53", "#c2185b", "#455a64")
# Colour of baselines that have none in COLOURS.
GREY = "#7f8790"
# Error at which the chart of errors ends, relative to that of always predicting zero: larger values
# stand at its edge, as a number.
CHART_LIMIT = 1.5


class Picture(NamedTuple):
    """A PNG or JPEG file with its caption."""

    path: Path
    caption: str

    @property
    def source(self) -> str:
        """The file as an address that contains it."""
        kind = {".png": "png", ".jpg": "jpeg"}[self.path.suffix]
        content = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:image/{kind};base64,{content}"


def curve_kinds(table: pd.DataFrame) -> dict[str, str]:
    """Return kind of a curve → model, for the best model with and the best without the scene.

    The prediction is that of the best model if none gets the scene.
    """
    models = {"predicted": with_scene(table) or rank_models(table)[0]}
    blind = without_scene(table)
    if blind and blind != models["predicted"]:
        models["without the scene"] = blind
    return models


def choose_colours(table: pd.DataFrame) -> dict[str, Any]:
    """Return method → its colour in all charts of a task."""
    kind_of = {model: kind for kind, model in curve_kinds(table).items()}
    others = cycle(OTHERS)
    chosen: dict[str, Any] = {}
    for name in list_methods(table):
        kind = kind_of.get(name, name)
        if kind in COLOURS:
            chosen[name] = chart_colour(kind)
        else:
            chosen[name] = GREY if name in BASELINES else next(others)
    return chosen


def _draw_panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure of some panels below each other, of a height in inches each."""
    figure = Figure(figsize=(WIDTH, height * count), layout="constrained")
    return figure, figure.subplots(count, squeeze=False)[:, 0].tolist()


def _set_title(panel: Axes, title: str) -> None:
    """Set the title of a panel, with a legend below it, where no curve is."""
    panel.set_title(title, loc="left", pad=26)
    if panel.lines:
        panel.legend(
            loc="lower left",
            bbox_to_anchor=(-0.02, 0.98),
            ncols=4,
            frameon=False,
            fontsize="small",
            handlelength=1.2,
            columnspacing=1,
        )


def draw_errors(folder: Path, task: str, table: pd.DataFrame) -> Picture:
    """Draw the errors of models and baselines with their 95 % intervals, a line for each value."""
    names = list_methods(table)
    labels = list_ends(table) or list(dict.fromkeys(["", *list_ranges(table)]))
    measure = measure_of(table, task, labels[0])
    zero = lead_errors(table)["zero"]
    limit = CHART_LIMIT * (zero if zero > 0 else 1)
    figure, (panel,) = _draw_panels(1, 0.7 + 0.24 * len(labels) * (len(names) + 1))
    colour_of = choose_colours(table)
    heads: list[str] = []
    for label in labels:
        if len(labels) > 1:
            title = label or "mean over the ranges"
            panel.text(0.02, len(heads), title, va="center", fontweight="bold")
        heads.append("")
        for name in names:
            row = table.loc[(label, name)]
            _draw_interval(panel, len(heads), row, measure, limit, colour_of[name])
            heads.append(name)
        zero = statistics.value_of(table.loc[(label, "zero")])
        if zero is not None and zero < limit:
            lines = [len(heads) - len(names) - 0.5, len(heads) - 0.5]
            panel.plot([zero, zero], lines, color=GREY, linewidth=1, linestyle=":")
    panel.set(xlim=(0, limit), ylim=(len(heads), -0.7))
    unit = f" in {measure.unit}" if measure.unit else ""
    panel.set_xlabel(f"{measure.title}{unit}; dotted: always zero")
    panel.set_yticks(range(len(heads)), heads)
    panel.tick_params(axis="y", length=0)
    panel.spines[["left", "right", "top"]].set_visible(False)
    path = folder / f"errors-{task}.png"
    street_view.save_figure(figure, path)
    caption = f"The {measure.title} of the {title_of(task)} on the test drives, with its 95 % "
    caption += "interval. An "
    return Picture(path, caption + "arrow marks what is beyond the edge.")


def _draw_interval(
    panel: Axes, line: int, row: pd.Series, measure: Measure, limit: float, colour: Any
) -> None:
    """Draw a value with its interval on a line, and write the value beside the chart."""
    value = statistics.value_of(row)
    if value is None:
        return
    panel.text(1.03 * limit, line, statistics.number_text(value, measure), va="center")
    farthest = value
    if not pd.isna(row["low"]):
        panel.plot([row["low"], row["high"]], [line, line], color=colour, linewidth=2)
        farthest = max(value, row["high"])
    if value <= limit:
        panel.plot(value, line, "o", color=colour, clip_on=False)
    if farthest > limit:
        panel.plot(limit, line, ">", color=colour, clip_on=False)


def draw_learning(folder: Path, values: pd.DataFrame, train: Path) -> Picture | None:
    """Draw the learning curves of all networks, a panel for each task.

    A curve is the validation error, or a dotted curve of the training loss if a network has no
    validation error. `train` is the folder of stage train.
    """
    if not any(train.rglob("curve.csv")):
        return None
    tasks = values.index.unique("task")
    figure, panels = _draw_panels(len(tasks), 2.6)
    for panel, task in zip(panels, tasks, strict=True):
        for model, colour in choose_colours(values.loc[task]).items():
            name = model
            for file in sorted((train / model).rglob("curve.csv")):
                curve = pd.read_csv(file)
                is_validated = curve["val_nmse"].notna().any()
                column = "val_nmse" if is_validated else "train_loss"
                style = "-" if is_validated else ":"
                panel.plot(curve["epoch"], curve[column], style, color=colour, label=name)
                name = ""  # further seeds are not in the legend
        panel.set_ylim(bottom=0)
        _set_title(panel, title_of(task))
        panel.set(xlabel="epoch", ylabel="nmse, or training loss")
    path = folder / "learning.png"
    street_view.save_figure(figure, path)
    caption = "Each line is a seed: nmse on the validation drives; dotted, without these, the "
    return Picture(path, caption + "training loss.")


def curve_values(task: Task, table: pd.DataFrame) -> dict[str, np.ndarray]:
    """Return kind of a curve → values [N,R], those of a model's first seed."""
    predictions = task.predictions
    values = {"driven": predictions.truth}
    # Odometry is of the present, and far off for what lies ahead.
    if "odometry" in predictions.predicted and not predictions.quantity.is_ahead:
        values["odometry"] = predictions.predicted["odometry"][0]
    for kind, model in curve_kinds(table).items():
        values[kind] = predictions.predicted[model][0]
    return values


def shown_values(task: Task, table: pd.DataFrame) -> pd.DataFrame:
    """Return the frames with the number that charts show, in a column for each kind of curve.

    A further column, cost, is the squared error of the model that predicts, of its first seed.
    """
    shown = task.predictions.frames.copy()
    for kind, values in curve_values(task, table).items():
        shown[kind] = task.predictions.quantity.shown(values)
    shown["cost"] = (shown["predicted"] - shown["driven"]) ** 2
    return shown


def typical_drives(shown: pd.DataFrame) -> dict[str, str]:
    """Return drive → rank, for the median and the worst drive by the cost."""
    costs = shown.groupby("drive")["cost"].mean().dropna()
    drives = costs.sort_values(kind="stable").index
    if len(drives) < 2:
        return dict.fromkeys(drives, "only")
    return {drives[(len(drives) - 1) // 2]: "median", drives[-1]: "worst"}


def draw_over_time(folder: Path, task: Task, table: pd.DataFrame) -> Picture | None:
    """Draw driven values, odometry and predictions over time, for the typical drives."""
    quantity = task.predictions.quantity
    shown = shown_values(task, table)
    drives = typical_drives(shown)
    if not drives:
        return None
    figure, panels = _draw_panels(len(drives), 2.6)
    limit = (
        1.05 * shown[shown["drive"].isin(drives)][[*curve_values(task, table)]].abs().max().max()
    )
    for panel, (drive, rank) in zip(panels, drives.items(), strict=True):
        rows = shown[shown["drive"] == drive]
        for kind in curve_values(task, table):
            time_s = rows["time_s"] - rows["time_s"].iloc[0]
            panel.plot(time_s, rows[kind], color=chart_colour(kind), label=kind)
        panel.axhline(0, color=GREY, linewidth=0.8)
        panel.set(ylim=(-limit or -1, limit or 1), xlabel="time in s")
        panel.set_ylabel(f"{quantity.shown_title}\nin {quantity.axis_title()}")
        _set_title(panel, f"{rank} drive, {drive}")
    path = folder / f"time-{task.name}.png"
    street_view.save_figure(figure, path)
    caption = f"The {quantity.shown_title} over time, in the drives of median and largest error of "
    return Picture(
        path, caption + f"`{curve_kinds(table)['predicted']}`, whose first seed is shown."
    )


def median_bend(shown: pd.DataFrame) -> pd.Series:
    """Return the first frame of a drive that has nearly all of its largest turn ahead.

    The drive is that of median error among the half of the drives that turn most. Drives that begin
    in their bend, most of which the image then does not show, are left out if there are others.
    """
    counted = shown.dropna(subset="cost")
    drive = counted["drive"]
    turn = counted["driven"].abs()

    # The half of the drives that turn most.
    largest = turn.groupby(drive).max().sort_values(kind="stable")
    first = turn.groupby(drive).first()[largest.index]
    begins_before = largest[first < largest / 2]
    if len(begins_before):
        largest = begins_before
    turning = largest.index[len(largest) // 2 :]

    cost = counted["cost"].groupby(drive).sum()
    by_cost = cost[turning].sort_values(kind="stable")
    name = by_cost.index[len(by_cost) // 2]
    turns = (drive == name) & (turn >= 0.9 * largest[name])
    return counted[turns].iloc[0]


def draw_bend(folder: Path, task: Task, table: pd.DataFrame, data: Path) -> Picture | None:
    """Draw the driven and the predicted paths of the median bend into its image."""
    quantity = task.predictions.quantity
    shown = shown_values(task, table)
    if not shown["cost"].notna().any():
        return None
    bend = median_bend(shown)
    drive = bend["drive"]
    ingest = data / f"ingest/{drive}.h5"
    perception = data / f"perception/{drive}.h5"
    if not ingest.is_file():
        return None

    # Rendered streets have true depth. Other images have that of the encoder.
    with open_ingest(ingest) as images:
        view = street_view.read_view(bend["frame"], images)
        camera = read_camera(images)
    if view.rgb is None:
        return None
    depth_m = view.depth_m
    depth_kind = "true"
    if depth_m is None and perception.is_file():
        with open_perception(perception) as perceived:
            depth_m = street_view.read_view(bend["frame"], perceived).depth_m
        depth_kind = "perceived"

    paths = read_paths(task, table, bend["drive"], bend["frame"])
    height, width = view.rgb.shape[:2]
    figure = Figure(figsize=(WIDTH, WIDTH * height / width))
    panel = figure.add_axes((0, 0, 1, 1))
    street_view.draw_paths_in_image(panel, view.rgb, camera, paths, depth_m)
    path = folder / "bend.jpg"
    street_view.save_figure(figure, path)

    models = curve_kinds(table)
    driven = f"the path of the driven {quantity.title}"
    if quantity.is_ahead:
        driven = f"the path that the car drove in the next {quantity.edges_m[-1]:g} m"
    caption = f"Frame {bend['frame']} of {drive}, a bend of median error. Red is {driven}, "
    caption += f"green the prediction of `{models['predicted']}`"
    if "without the scene" in models:
        caption += f", blue that of `{models['without the scene']}`, without the scene"
    if "odometry" in paths:
        caption += ", orange *odometry*"
    caption += "."
    if depth_m is not None:
        caption += f" A path ends where something stands in front of it, by the {depth_kind} depth."
    return Picture(path, caption)


def read_paths(task: Task, table: pd.DataFrame, drive: str, frame: int) -> dict[str, np.ndarray]:
    """Return kind of a curve → curvature of each step of its path, in a frame."""
    quantity = task.predictions.quantity
    frames = task.predictions.frames
    is_frame = (frames["drive"] == drive) & (frames["frame"] == frame)
    paths = {}
    for kind, values in curve_values(task, table).items():
        (curvature_1pm,) = quantity.curvature(values[is_frame])
        paths[kind] = street_view.path_steps(curvature_1pm, quantity.edges_m)
    return paths


def draw_chain(folder: Path, task: Task, table: pd.DataFrame, data: Path) -> Picture | None:
    """Draw the way of the frame of :func:`draw_bend` from image to graph.

    The graph is that of the best model that sees points. `data` is the folder of all stages.
    """
    with_points = []
    for name in rank_models(table):
        source = task.models[name]["variant"].get("source", "")
        if table.loc[("", name), "scene"] and source.startswith("clouds"):
            with_points.append(name)
    shown = shown_values(task, table)
    if not with_points or not shown["cost"].notna().any():
        return None
    bend = median_bend(shown)
    content = task.models[with_points[0]]
    entry = content["entry"]
    folders = {
        "ingest": "ingest",
        "perception": "perception",
        "clouds": content["variant"]["source"],
        "graphs": f"graphs/{entry['input']}",
    }
    files = {stage: data / name / f"{bend['drive']}.h5" for stage, name in folders.items()}
    if not all(file.is_file() for file in files.values()):
        return None
    with ExitStack() as stack:
        opened = dict[str, DriveReader]()
        opened["ingest"] = stack.enter_context(open_ingest(files["ingest"]))
        opened["perception"] = stack.enter_context(open_perception(files["perception"]))
        opened["clouds"] = stack.enter_context(open_clouds(files["clouds"]))
        opened["graphs"] = stack.enter_context(open_graphs(files["graphs"]))
        if not all(bend["frame"] in file.frame for file in opened.values()):
            return None
        graph = street_view.read_view(bend["frame"], opened.pop("graphs"))
        view = street_view.read_view(bend["frame"], *opened.values())

    path = folder / "chain.jpg"
    street_view.save_figure(street_view.draw_sheet("", view, graph), path)
    caption = f"From image to graph (Figure 1 of the paper): frame {bend['frame']} of "
    caption += f"{bend['drive']}. `{with_points[0]}` gets the graph, of this frame and of the "
    return Picture(path, f"{caption}{entry['window'] - 1} before.")
