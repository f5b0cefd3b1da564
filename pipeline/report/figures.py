"""Draw the pictures of the page from the outputs of stages, as PNG files with captions."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera.camera import read_camera
from pipeline.report import street_view
from pipeline.report.results import Group
from pipeline.report.street_view import View
from pipeline.report.summary import Comparison
from pipeline.train.quantity import Quantity

# Matplotlib's colours of curves.
_COLOURS = {"true": "0.15", "odometry": "tab:orange", "predicted": "tab:blue"}
Captions = dict[str, str]  # name of the file without suffix → caption


def draw_bend(path: Path, group: Group, comparison: Comparison, ingest: Path) -> str:
    """Draw the paths of the median bend into its image, and return a caption.

    Nothing is drawn, and the caption is empty, if the image is missing in `ingest`, the folder of
    that stage.
    """
    model = comparison.by_error[0]
    drive, frame = median_bend(group.first_seed(model))
    paths = read_paths(group, comparison, model, drive, frame)
    caption = f"The path from frame {frame} of {drive}. "
    caption += f"Red is {_driven_path(group.quantity)}, green the prediction of model {model}"
    if "without the scene" in paths:
        caption += f", and blue that of model {comparison.without_scene}, without the scene"
    caption += ". This is the drive of median error among the half of the drives that turn most."
    return caption if _draw_paths(path, ingest, drive, frame, paths) else ""


def draw_chain(
    path: Path, group: Group, comparison: Comparison, data: Path
) -> tuple[str, list[View]]:
    """Draw a frame's way from image to steering, and return a caption and the graphs of its drive.

    The model is the best that sees points, and the frame that of :func:`draw_bend`. Nothing is
    drawn if a file of a stage is missing in the folder `data`.
    """
    with_points = [
        name
        for name in comparison.by_error
        if comparison.gets_scene(name) and group.models[name]["variant"]["source"] != "ingest"
    ]
    if not with_points:
        return "", []
    model = with_points[0]
    row = group.models[model]
    predictions = group.first_seed(model)
    drive, number = median_bend(predictions)

    folders = {
        "ingest": "ingest",
        "perception": "perception",
        "clouds": row["variant"]["source"],
        "graphs": f"graphs/{row['entry']['input']}",
    }
    paths = {stage: data / folder / f"{drive}.h5" for stage, folder in folders.items()}
    if not all(file.is_file() for file in paths.values()):
        return "", []
    with ExitStack() as stack:
        files = {}
        for stage, file in paths.items():
            files[stage] = stack.enter_context(store.DriveReader(file, stage=stage))
        if not all(number in file.frame for file in files.values()):
            return "", []
        graphs = files.pop("graphs")
        view = street_view.read_view(number, *files.values())
        graph = street_view.read_view(number, graphs)
        views = street_view.read_some(graphs)

    figure, last_panel = _draw_panels(view, graph)
    if group.quantity.is_ahead:
        driven_and_predicted = read_paths(group, comparison, model, drive, number)
        street_view.draw_paths_from_above(last_panel, driven_and_predicted)
        last_panel.set_title(group.quantity.title)
        last_panel.legend(frameon=False)
    else:
        of_drive = predictions[predictions["drive"] == drive]
        _draw_over_time(last_panel, of_drive, number, group.quantity)
    street_view.save(figure, path)
    caption = (
        f"From image to steering (Figure 1 of the paper): frame {number} of {drive}, a bend of "
        f"median error of {model}. The network gets the graph, of this frame and of the "
        f"{row['entry']['window'] - 1} before."
    )
    return caption, views


def read_paths(
    group: Group, comparison: Comparison, model: str, drive: str, frame: int
) -> dict[str, np.ndarray]:
    """Return kind → curvature of each step, of the path ahead of a frame.

    Kinds are the driven path, that predicted by the first seed of `model`, and that by the best
    model without the scene, if there is another one. Steps are those of
    :func:`street_view.path_steps`.
    """
    quantity = group.quantity
    columns = {"driven": "true", "predicted": "predicted"}
    models = dict.fromkeys(columns, model)
    blind = comparison.without_scene
    if blind and blind != model:
        columns["without the scene"] = "predicted"
        models["without the scene"] = blind

    paths = {}
    for kind, column in columns.items():
        predictions = group.first_seed(models[kind])
        rows = predictions[(predictions["drive"] == drive) & (predictions["frame"] == frame)]
        if len(rows):
            values = rows[[f"{column}_{name}" for name in quantity.columns]].to_numpy()[0]
            curvature_1pm = quantity.curvature(values)
            paths[kind] = street_view.path_steps(curvature_1pm, quantity.edges_m)
    return paths


def _driven_path(quantity: Quantity) -> str:
    """Return in words what the path of the true values is."""
    if quantity.is_ahead:
        return f"the path that the car drove in the next {quantity.edges_m[-1]:g} m"
    return f"the path of the driven {quantity.title}"


def median_bend(predictions: pd.DataFrame) -> tuple[str, int]:
    """Return the drive of median error among those that turn most, and its sharpest frame."""
    predicted = predictions.dropna(subset="cost")
    turn = predicted["shown_true"].abs()
    sharpest = predicted.loc[turn.groupby(predicted["drive"]).idxmax()].set_index("drive")

    # The half of the drives that turn most, by their error.
    by_turn = sharpest["shown_true"].abs().sort_values()
    bends = by_turn.index[len(by_turn) // 2 :]
    costs = predicted.groupby("drive")["cost"].sum()[bends].sort_values()
    drive = str(costs.index[len(costs) // 2])
    return drive, int(sharpest.loc[drive, "frame"])


def _draw_panels(view: View, graph: View) -> tuple[Figure, Axes]:
    """Draw the image, depth, classes and cloud of a frame and its pruned graph.

    `view` has no points of the graph, which are in `graph`. Returns the figure and its last panel,
    which is empty.
    """
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    panels = figure.subplot_mosaic("aabbcc;ddeeff", height_ratios=[1, 2.2])
    for key in "abc":  # classes may be missing
        panels[key].set_axis_off()
    for key, (name, pixels) in zip("abc", view.images().items(), strict=False):
        title = "image" if key == "a" else f"{name} from the image"
        street_view.draw_image(panels[key], pixels, title)
    street_view.draw_points(panels["d"], view, fontsize="medium")
    street_view.draw_points(panels["e"], graph, fontsize="medium")
    street_view.class_legend(figure, view, columns=10)
    return figure, panels["f"]


def _draw_over_time(panel: Axes, predictions: pd.DataFrame, frame: int, quantity: Quantity) -> None:
    """Draw the driven, measured and predicted values of a drive over time, and mark a frame."""
    for kind, style in {"true": "-", "odometry": "--", "predicted": "-"}.items():
        shown = predictions[f"shown_{kind}"]
        if shown.notna().any():
            label = "driven" if kind == "true" else kind
            panel.plot(predictions["elapsed_s"], shown, style, color=_COLOURS[kind], label=label)
    time_s = predictions.loc[predictions["frame"] == frame, "elapsed_s"].iloc[0]
    panel.axvline(time_s, color="0.7", linewidth=1)
    title = f"{quantity.shown_title} in {quantity.axis_title()}; grey: this frame"
    panel.set(xlabel="time in s", title=title)
    panel.margins(x=0)
    panel.legend(frameon=False)


def draw_errors(out: Path, comparison: Comparison, group: Group, ingest: Path) -> Captions:
    """Draw the driven and the predicted path at the largest error in each typical drive.

    The predictions are those of the best model, and typical drives are its best, median and worst
    drive. Nothing is drawn for a frame without an image in `ingest`, the folder of that stage.
    """
    model = comparison.by_error[0]
    predictions = group.first_seed(model)
    captions = Captions()
    for drive, rank in group.typical_drives(model).items():
        row = predictions.loc[predictions["cost"].where(predictions["drive"] == drive).idxmax()]
        paths = read_paths(group, comparison, model, drive, row["frame"])
        name = f"{group.key}-{rank}"
        if _draw_paths(out / f"{name}.png", ingest, drive, row["frame"], paths):
            driven = group.quantity.text(row["shown_true"])
            predicted = group.quantity.text(row["shown_predicted"])
            captions[name] = (
                f"Frame {row['frame']}, the largest error of {model} in this drive: driven "
                f"{driven} (red), predicted {predicted} (green), left is positive. The image is "
                "the last one of the input."
            )
    return captions


def _draw_paths(
    path: Path, ingest: Path, drive: str, frame: int, paths: dict[str, np.ndarray]
) -> bool:
    """Draw paths into the image of a frame. Returns whether there are a path and an image.

    `paths` is kind → curvature of each step, and `ingest` the folder of that stage.
    """
    if not any(np.isfinite(curvature_1pm).any() for curvature_1pm in paths.values()):
        return False
    if not (ingest / f"{drive}.h5").is_file():
        return False
    with store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as images:
        if frame not in images.frame:
            return False
        number = images.row_of(frame)
        if not images["has_image"][number]:
            return False
        image = images.row("image", number)
        camera = read_camera(images)

    height, width = image.shape[:2]
    figure = Figure(figsize=(8, 8 * height / width))
    street_view.draw_paths_in_image(figure.add_axes((0, 0, 1, 1)), image, camera, paths)
    street_view.save(figure, path)
    return True
