"""Draw the pictures of the page from the outputs of stages, as PNG files with captions."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera.camera import Camera, read_camera
from pipeline.report import street_view
from pipeline.report.results import Group
from pipeline.report.street_view import View
from pipeline.report.summary import Comparison

# Least angle in degrees of the bend to the left that the picture of the chain shows. If no drive
# has such a bend, the picture shows the sharpest bend of all drives.
BEND_DEG = 5.0
# Length in metres of the path that a steering angle makes in an image.
PATH_M = 20.0
# Matplotlib's colours of angles.
_COLOURS = {"true": "0.15", "odometry": "tab:orange", "predicted": "tab:blue"}
Captions = dict[str, str]  # name of the file without suffix → caption


def draw_chain(
    path: Path, group: Group, models: Sequence[str], data: Path
) -> tuple[str, list[View]]:
    """Draw a frame's way from image to steering, and return a caption and the graphs of its drive.

    The model is the first of `models` that sees points. The drive is that of median error among the
    drives that bend left. Nothing is drawn if a file of a stage is missing in the folder `data`.
    """
    with_points = [
        name
        for name in models
        if group.models[name]["entry"]["spatial"] != "blind"
        and group.models[name]["variant"]["source"] != "ingest"
    ]
    if not with_points:
        return "", []
    model = with_points[0]
    row = group.models[model]
    predictions = group.first_seed(model)
    drive, number = _typical_bend(predictions)

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
    _draw_panels(path, view, graph, predictions[predictions["drive"] == drive])
    caption = (
        f"From image to steering (Figure 1 of the paper): frame {number} of {drive}, a drive of "
        f"median error of {model}. The network gets the graph, of this frame and of the "
        f"{row['entry']['window'] - 1} before."
    )
    return caption, views


def _typical_bend(predictions: pd.DataFrame) -> tuple[str, int]:
    """Return the drive of median error among those that bend left, and its sharpest frame."""
    # The sharpest frame of a drive has its largest angle to the left.
    predicted = predictions.dropna(subset="cost")
    sharpest = predicted.loc[predicted.groupby("drive")["true_deg"].idxmax()].set_index("drive")

    # If no drive bends by BEND_DEG, that with the largest angle is left.
    bends = sharpest[sharpest["true_deg"] >= min(BEND_DEG, sharpest["true_deg"].max())]
    costs = predicted.groupby("drive")["cost"].sum()[bends.index].sort_values()
    drive = str(costs.index[len(costs) // 2])
    return drive, int(bends.loc[drive, "frame"])


def _draw_panels(path: Path, view: View, graph: View, steering: pd.DataFrame) -> None:
    """Draw the image, depth, classes and cloud of a frame, its pruned graph, and the angles.

    `view` has no points of the graph, which are in `graph`. `steering` holds the predictions for
    the drive of the frame.
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
    _draw_angles(panels["f"], steering, view.frame)
    street_view.class_legend(figure, view, columns=10)
    street_view.save(figure, path)


def _draw_angles(panel: Axes, steering: pd.DataFrame, frame: int) -> None:
    """Draw the driven, measured and predicted angle over the time of a drive, and mark a frame."""
    for kind, style in {"true": "-", "odometry": "--", "predicted": "-"}.items():
        angle_deg = steering[f"{kind}_deg"]
        if angle_deg.notna().any():
            label = "driven" if kind == "true" else kind
            panel.plot(steering["elapsed_s"], angle_deg, style, color=_COLOURS[kind], label=label)
    time_s = steering.loc[steering["frame"] == frame, "elapsed_s"].iloc[0]
    panel.axvline(time_s, color="0.7", linewidth=1)
    panel.set(xlabel="time in s", title="steering in deg, left +; grey: this frame")
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
        path = ingest / f"{drive}.h5"
        if not path.is_file():
            continue
        row = predictions.loc[predictions["cost"].where(predictions["drive"] == drive).idxmax()]
        with store.DriveReader(path, stage="ingest") as images:
            if row["frame"] not in images.frame:
                continue
            number = images.row_of(row["frame"])
            if not images["has_image"][number]:
                continue
            image = images.row("image", number)
            camera = read_camera(images)
        paths = {}
        for kind, columns in {"driven": "true", "predicted": "predicted"}.items():
            values = np.array([row[f"{columns}_{column}"] for column in group.labels])
            paths[kind] = _path(values, group.edges_m, group.models[model]["wheelbase_m"])
        name = f"{group.key}-{rank}"
        _draw_paths(out / f"{name}.png", image, camera, paths)
        captions[name] = (
            f"Frame {row['frame']}, the largest error of {model} in this drive: driven "
            f"{row['true_deg']:.1f}° (red), predicted {row['predicted_deg']:.1f}° (green), left +. "
            "The image is the last one of the input."
        )
    return captions


def _path(values: np.ndarray, edges_m: Sequence[float], wheelbase_m: float) -> np.ndarray:
    """Return the curvature of each step of a path.

    `values` are the curvatures [R] in ranges with these edges. Without edges, they are one steering
    angle [1], which is held along the path.
    """
    if edges_m:
        return street_view.path_steps(values, edges_m)
    return street_view.path_steps(np.tan(values) / wheelbase_m, [0.0, PATH_M])


def _draw_paths(
    path: Path, image: np.ndarray, camera: Camera, paths: dict[str, np.ndarray]
) -> None:
    """Draw the wheels' tracks of paths into an image. `paths` is kind → curvature of each step."""
    height, width = image.shape[:2]
    figure = Figure(figsize=(8, 8 * height / width))
    panel = figure.add_axes((0, 0, 1, 1))
    street_view.draw_image(panel, image, "")
    panel.autoscale(False)
    for kind, curvature_1pm in paths.items():
        colour = np.array(street_view.PATHS[kind]) / 255
        for wheel in street_view.wheel_tracks(curvature_1pm, camera):
            panel.plot(*wheel.T, color=colour, linewidth=1.5)
    street_view.save(figure, path)
