"""Draw the pictures of the page from the stages' folders, as PNG files, and write their
captions.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera.camera import read_camera
from pipeline.report import street_view
from pipeline.report.results import Group
from pipeline.report.street_view import View

BEND_DEG = 5.0  # the least angle of the bend in the chain
_COLOURS = {"true": "0.15", "odometry": "tab:orange", "predicted": "tab:blue"}
Captions = dict[str, str]  # name of the file without suffix → caption
Figures = tuple[Captions, list[View]]  # and graphs of the chain's drive


def draw(out: Path, groups: Sequence[Group], data: Path) -> Figures:
    """Draw a frame's way from image to steering and errors in typical drives, if the stages' files
    are in `data`.
    """
    captions, views = _draw_typical_bend(out / "chain.png", groups[0], data) if groups else ({}, [])
    for group in groups:
        captions |= _draw_errors(out, group, data / "ingest")
    return captions, views


def _draw_typical_bend(path: Path, group: Group, data: Path) -> Figures:
    """Draw the chain of the best model that sees points, in the drive of median error among those
    that bend left.
    """
    rows = (row for row in group.by_error if row["variant"]["source"] != "ingest")
    if (model := next((row for row in rows if row["entry"]["spatial"] != "blind"), None)) is None:
        return {}, []
    steering = group.first_seed(model["model"])
    known = steering.dropna(subset="cost")
    sharpest = known.loc[known.groupby("drive")["true_deg"].idxmax()].set_index("drive")
    bends = sharpest[sharpest["true_deg"] >= min(BEND_DEG, sharpest["true_deg"].max())]
    costs = known.groupby("drive")["cost"].sum()[bends.index].sort_values()
    drive = str(costs.index[len(costs) // 2])
    number = int(bends.loc[drive, "frame"])
    folders = (
        "ingest",
        "perception",
        model["variant"]["source"],
        f"graphs/{model['entry']['input']}",
    )
    paths = {folder.split("/")[0]: data / folder / f"{drive}.h5" for folder in folders}
    if not all(file.is_file() for file in paths.values()):
        return {}, []
    with ExitStack() as stack:
        *files, graphs = [
            stack.enter_context(store.DriveReader(file, stage=stage))
            for stage, file in paths.items()
        ]
        if not all(number in file.frame for file in (*files, graphs)):
            return {}, []
        view, graph = street_view.read_view(number, *files), street_view.read_view(number, graphs)
        views = street_view.read_some(graphs)
    _draw_chain(path, view, graph, steering[steering["drive"] == drive])
    caption = (
        f"From image to steering (Figure 1 of the paper): frame {number} of {drive}, a drive of "
        f"median error of {model['model']}. The network gets what the second panel from above "
        f"shows, of this frame and the {model['entry']['window'] - 1} before."
    )
    return {path.stem: caption}, views


def _draw_chain(path: Path, view: View, graph: View, steering: pd.DataFrame) -> None:
    """Draw image, depth, classes, cloud, pruned graph, and the predicted angles [F] over the drive
    of `view`.
    """
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    panels = figure.subplot_mosaic("aabbcc;ddeeff", height_ratios=[1, 2.2])
    for key in "abc":  # classes may be missing
        panels[key].set_axis_off()
    for key, (name, pixels) in zip("abc", view.images().items(), strict=False):
        street_view.draw_image(
            panels[key], pixels, "image" if key == "a" else f"{name} from the image"
        )
    street_view.draw_points(panels["d"], view, fontsize="medium")
    street_view.draw_points(panels["e"], graph, fontsize="medium")
    panel = panels["f"]
    for kind, style in {"true": "-", "odometry": "--", "predicted": "-"}.items():
        if steering[f"{kind}_deg"].notna().any():
            label = "driven" if kind == "true" else kind
            panel.plot(
                steering["elapsed_s"],
                steering[f"{kind}_deg"],
                style,
                color=_COLOURS[kind],
                label=label,
            )
    panel.axvline(
        steering["elapsed_s"][steering["frame"] == view.frame].iloc[0], color="0.7", linewidth=1
    )
    panel.set(xlabel="time in s", title="steering in deg, left +; grey: this frame")
    panel.margins(x=0)
    panel.legend(frameon=False)
    street_view.class_legend(figure, view, columns=10)
    street_view.save(figure, path)


def _draw_errors(out: Path, group: Group, ingest: Path) -> Captions:
    """Draw the last image before the largest error in each typical drive, with the paths; nothing
    without images.
    """
    model, captions = group.by_error[0], Captions()
    predictions = group.first_seed(model["model"])
    on_path = any(group.labels.values())
    edges_m = [0.0, *(column["to_m"] for column in model["columns"].values())]
    for drive, rank in group.typical_drives.items():
        row = predictions.loc[predictions["cost"].where(predictions["drive"] == drive).idxmax()]
        if not (file := ingest / f"{drive}.h5").is_file():
            continue
        with store.DriveReader(file, stage="ingest") as images:
            if (
                row["frame"] not in images.frame
                or not images["has_image"][number := images.row_of(row["frame"])]
            ):
                continue
            image, camera = images.row("image", number), read_camera(images)
        figure = Figure(figsize=(8, 8 * image.shape[0] / image.shape[1]))
        panel = figure.add_axes((0, 0, 1, 1))
        street_view.draw_image(panel, image, "")
        panel.autoscale(False)
        for kind in ("driven", "predicted") if on_path else ():
            path_1pm = [
                row[f"{'true' if kind == 'driven' else kind}_{column}"] for column in group.labels
            ]
            for side in street_view.wheel_tracks(street_view.path_steps(path_1pm, edges_m), camera):
                panel.plot(
                    *side.T, color=[value / 255 for value in street_view.PATHS[kind]], linewidth=1.5
                )
        path = out / f"{group.key}-{rank}.png"
        street_view.save(figure, path)
        captions[path.stem] = (
            f"Frame {row['frame']}, the largest error of {model['model']} in this drive: driven "
            f"{row['true_deg']:.1f}°{' (red)' * on_path}, predicted "
            f"{row['predicted_deg']:.1f}°{' (green)' * on_path}, left +. The image is the last one "
            "of the input."
        )
    return captions
