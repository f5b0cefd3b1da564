"""Draw the figures of the paper that the data at hand allows, as PNG and SVG files, and write their captions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pipeline.base import store
from pipeline.camera import classes
from pipeline.camera.camera import Camera, read_camera
from pipeline.evaluate.paths import Track, segments
from pipeline.graphs import graph, graph_file
from pipeline.report import figure_file, street_view
from pipeline.report.path import COLOURS, STEP_M, path_steps, wheel_tracks
from pipeline.report.path_ahead import PathResults
from pipeline.report.results import Results, load_structures, steering_lines

_FOLDERS = ("ingest", "perception", "clouds/pseudo")
CHAIN_POINTS, PRUNING_POINTS = 300, 100
MAX_MODELS = 4  # models with a path in Figure 4
MAX_COLUMNS = 4  # panels side by side
MAX_ERRORS, APART_S = 6, 1.0  # frames with the largest errors, and the least time between them
FORMULA = {"bicycle": "bicycle model", "paper": "the paper's formula, which takes the steering angle as heading"}
ERRORS = "errors"  # the figures with the largest errors are called errors-HORIZON
Captions = dict[str, str]
"""Name of the file without suffix → caption."""


def draw(out: Path, results: Results, paths: Sequence[PathResults], data: Path) -> Captions:
    """Draw figures of the best model that predicts the current angle, from the stages' folders in `data`.

    The largest errors are drawn for the best model of each horizon, and for the best of the path ahead.
    """
    captions: Captions = {}
    by_error = results.models.sort_values("test.nmse", kind="stable") if len(results.models) else pd.DataFrame()
    for horizon, models in by_error.groupby("line.horizon") if len(by_error) else ():
        best = models.iloc[0]
        steering = results.first_seed([best["model"]])
        if horizon == 0:
            captions |= _draw_images(out, best, steering, data)
            captions |= _draw_pruning(out, best, data / "evaluate")
            captions |= _draw_paths(out, models[:MAX_MODELS], results)
        angles = f"angles {horizon} frames later" if horizon else "angles"
        captions |= _draw_errors(out / f"{ERRORS}-{horizon}", best["model"], angles, steering, data / "ingest")
    for path in sorted(paths, key=lambda path: path.mean_nmse)[:1]:
        angles = f"paths and the angles by which they turn in {path.ahead_m[-1]:g} m"
        first = path.predictions[path.predictions["run"] == ""]
        captions |= _draw_errors(out / f"{ERRORS}-path", path.metrics.model, angles, first, data / "ingest", path)
    return captions


def _save(figure: Figure, path: Path) -> None:
    figure_file.save(figure, path.with_suffix(".png"))
    figure.set_layout_engine("none")  # computing it again takes longer than drawing
    figure_file.save(figure, path.with_suffix(".svg"))


def _draw_images(out: Path, model: pd.Series, steering: pd.DataFrame, data: Path) -> Captions:
    """Draw Figures 1 and 2, a frame's way from image to steering, and perception: each drive's sharpest left turn."""
    predicted = steering.dropna(subset=["driven_deg", "predicted_deg"])
    rows = predicted.loc[predicted.groupby("drive")["predicted_deg"].idxmax()]
    frames = rows.sort_values("predicted_deg", ascending=False)[["drive", "frame"]].to_numpy().tolist()
    views = [(drive, view) for drive, number in frames if (view := _read_view(data, drive, number))]
    if not views:
        return {}
    drive, view = views[0]
    captions = {}
    if pd.notna(model["variant.k"]):
        _draw_chain(out / "chain", model, view, steering[steering["drive"] == drive])
        captions["chain"] = (
            f"Figure 1. From image to steering: frame {view.frame} of {drive}. {model['model']} gets the graphs of "
            f"{model['line.window']} such frames, with {model['points_per_frame']:,.0f} points each."
        )
    drive, view = views[-1]
    _save(street_view.sheet(drive, [view]), out / "street")
    names = ", ".join(["image", *[*view.images()][1:], "cloud from above"])
    captions["street"] = f"Figure 2. {drive}, frame {view.frame}: {names}."
    return captions


def _read_view(data: Path, drive: str, number: int) -> street_view.View | None:
    """Read a frame's image, perception and cloud; None if a file or the frame is missing."""
    files = [(data / folder / f"{drive}.h5", folder.split("/")[0]) for folder in _FOLDERS]
    if not all(path.is_file() for path, _ in files):
        return None
    images, perceived, cloud = (store.DriveReader(path, stage=stage) for path, stage in files)
    with images, perceived, cloud:
        if not all(number in file.frame for file in (images, perceived, cloud)):
            return None
        return street_view.read_view(images, perceived, cloud, number)


def _draw_chain(path: Path, model: pd.Series, view: street_view.View, steering: pd.DataFrame) -> None:
    """Draw image, depth, classes, cloud, pruned graph, and steering [F] over the drive of `view`."""
    figure = Figure(figsize=(13, 6.4), layout="constrained")
    panels = figure.subplot_mosaic("aabbcc;ddeeff", height_ratios=[1, 2.2])
    images = [*view.images().items()]
    for key, (name, pixels) in zip("abc", images, strict=False):
        street_view.draw_image(panels[key], pixels, "image" if key == "a" else f"{name} from the image")
    for key in "abc"[len(images) :]:
        panels[key].set_axis_off()
    assert view.xyz is not None
    assert view.points_cls is not None
    street_view.draw_points(panels["d"], view.xyz, view.points_cls)
    panels["d"].set_title(f"cloud from above: {len(view.xyz):,} points")
    keep = model["variant.keep_inter_class"]
    pruned = _draw_graph(panels["e"], view.xyz, view.points_cls, CHAIN_POINTS, model["variant.k"], keep)
    kept = f", pruned to {pruned.edges_kept:,}" if pruned.edges_kept < pruned.edges_knn else ""
    panels["e"].set_title(f"graph of {len(pruned.degree)} points: {pruned.edges_knn:,} edges{kept}")
    for key in "de":
        street_view.look_ahead(panels[key])
    panel = panels["f"]
    styles = {"driven": ("0.15", "-", 2.5), "odometry": ("tab:orange", "--", 1.5)}
    for name, curve in steering_lines(steering).items():
        colour, dash, width = styles.get(name, ("tab:blue", "-", 1.5))
        label = name if name in styles else "predicted"
        panel.plot(curve["elapsed_s"], curve["deg"], color=colour, linestyle=dash, linewidth=width, label=label)
    panel.axvline(steering["elapsed_s"][steering["frame"] == view.frame].iloc[0], color="0.7", linewidth=1)
    panel.set(xlabel="time in s", title="steering in deg, left +; grey: this frame")
    panel.margins(x=0)
    panel.legend(frameon=False)
    street_view.class_legend(figure, view.all_classes(), columns=10)
    _save(figure, path)


def _draw_graph(
    panel: Axes, xyz: np.ndarray, cls: np.ndarray, points: int, k: int, keep_inter_class: float
) -> graph.Graph:
    """Draw and return the graph of at most `points` points of a cloud xyz [P,3] with trainIds [P], from above."""
    rows = np.sort(np.random.default_rng(0).choice(len(xyz), min(points, len(xyz)), replace=False))
    xyz, cls = xyz[rows], cls[rows]
    built = graph.build(xyz, cls, k, keep_inter_class, np.random.default_rng(0))
    street_view.draw_points(panel, xyz, cls, graph_file.edge_pairs(built.degree, built.indices))
    return built


def _draw_pruning(out: Path, model: pd.Series, evaluate: Path) -> Captions:
    """Draw the kNN graph of the first frame in structure.json, before and after pruning; nothing without classes."""
    structures = load_structures(evaluate / model["model"])
    if not structures or pd.isna(model["variant.k"]):
        return {}
    drive, structure = next(iter(structures.items()))
    xyz, cls = np.array(structure.xyz_m, np.float32), np.array(structure.cls, np.uint8)
    if (cls == classes.VOID).all():
        return {}
    title, keep = f"{drive}, frame {structure.frame}", model["variant.keep_inter_class"]
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for panel, (name, share) in zip(figure.subplots(1, 2), (("before", 1.0), ("after", keep)), strict=True):
        built = _draw_graph(panel, xyz, cls, PRUNING_POINTS, model["variant.k"], share)
        panel.set_title(f"{name} pruning: {built.edges_kept} edges", fontsize="medium")
        panel.set_adjustable("datalim")
    street_view.class_legend(figure, cls, columns=8)
    figure.suptitle(title)
    _save(figure, out / "pruning")
    caption = (
        f"Figure 3. {title}, sampled to {len(built.degree)} points: the graph of {model['variant.k']} nearest "
        f"neighbours before and after pruning of edges between classes to {keep:.0%}. Edges are directed, as in the "
        "paper and in all tables."
    )
    return {"pruning": caption}


def largest_errors(predictions: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with the largest errors, with the `share` of the squared error within APART_S of each."""
    rows = predictions.dropna(subset=["driven_deg", "predicted_deg"])
    rows = rows.assign(cost=(rows["predicted_deg"] - rows["driven_deg"]) ** 2).query("cost > 0")
    remaining, largest = rows, list[dict[str, Any]]()
    while len(remaining) and len(largest) < MAX_ERRORS:
        row = remaining.loc[remaining["cost"].idxmax()]
        around = (rows["drive"] == row["drive"]) & ((rows["elapsed_s"] - row["elapsed_s"]).abs() <= APART_S)
        largest.append({**row, "share": rows["cost"][around].sum() / rows["cost"].sum()})
        remaining = remaining[~around[remaining.index]]
    return pd.DataFrame(largest)


def _draw_errors(
    file: Path, model: str, angles: str, predictions: pd.DataFrame, ingest: Path, paths: PathResults | None = None
) -> Captions:
    """Draw the last image that a model got before each of its largest errors; nothing without images.

    `angles`: the meaning of driven_deg and predicted_deg. With `paths`, both paths are drawn on the street.
    """
    shown = []
    for _, row in largest_errors(predictions).iterrows():
        if found := _read_image(ingest / f"{row['drive']}.h5", row["frame"]):
            shown.append((row, *found))
    if not shown:
        return {}
    (height, width), rows = shown[0][1].shape[:2], -(-len(shown) // 2)
    figure = Figure(figsize=(12, (6 * height / width + 0.3) * rows), layout="constrained")
    for panel in figure.subplots(rows, 2, squeeze=False).ravel():
        panel.set_axis_off()
    for panel, (row, image, camera) in zip(figure.axes, shown, strict=False):
        panel.imshow(image)
        if paths:
            for kind in ("driven", "predicted"):
                steps = path_steps(paths.curvature_1pm(row, kind), paths.ahead_m, STEP_M)
                draw_path(panel, wheel_tracks(steps, camera), kind)
        text = f"driven {row['driven_deg']:.1f}°, predicted {row['predicted_deg']:.1f}°"
        title = f"{row['drive']}, frame {row['frame']}: {text}, share {row['share']:.0%}"
        panel.set_title(title, fontsize="small", loc="left")
    _save(figure, file)
    colours = " Red: driven, green: predicted." if paths else ""
    caption = (
        f"Largest errors of {model}, first seed: the last image of its input, {angles} (left +), and the share of the "
        f"squared error that lies within {APART_S:g} s.{colours}"
    )
    return {file.name: caption}


def draw_path(panel: Axes, tracks: Sequence[np.ndarray], kind: str) -> None:
    """Draw the tracks of both wheels, :func:`wheel_tracks`, over the image in a panel; `kind`: a key of COLOURS."""
    limits = panel.get_xlim(), panel.get_ylim()
    left, right = tracks
    colour = [value / 255 for value in COLOURS[kind]]
    panel.fill(*np.concatenate([left, right[::-1]]).T, color=colour, alpha=0.3, linewidth=0)
    for side in tracks:
        panel.plot(*side.T, color=colour, linewidth=1.5)
    panel.set(xlim=limits[0], ylim=limits[1])


def _read_image(path: Path, number: int) -> tuple[np.ndarray, Camera] | None:
    """Read a frame's image and its camera from a file of stage ingest; None if file, frame or image is missing."""
    if not path.is_file():
        return None
    with store.DriveReader(path, stage="ingest") as images:
        if number not in images.frame:
            return None
        row = images.row_of(number)
        return (images.row("image", row), read_camera(images)) if images["has_image"][row] else None


def _draw_paths(out: Path, models: pd.DataFrame, results: Results) -> Captions:
    """Draw the driven path of each drive, and the paths of predicted steering. Dots are restarts."""
    first, drives = models.iloc[0], [*results.worst_drives(models).groupby("drive", sort=False)]
    rows = -(-len(drives) // MAX_COLUMNS)
    columns = -(-len(drives) // rows)
    figure = Figure(figsize=(4.0 * columns, 4.2 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(drives) :]:
        panel.set_axis_off()
    for panel, (drive, tables) in zip(panels, drives, strict=False):
        truth = tables.drop_duplicates("frame").sort_values("frame")
        track = Track(
            time_s=truth["elapsed_s"].to_numpy(),
            speed_mps=truth["speed_mps"].to_numpy(),
            steering_rad=np.nan_to_num(truth["steering_rad"].to_numpy()),
            onsets=np.flatnonzero(truth["onset"]),
            wheelbase_m=first["wheelbase_m"],
            formula=first["path"],
        )
        true = track.path(track.steering_rad, 0, len(truth))
        panel.plot(-true[:, 1], true[:, 0], color="0.15", linewidth=3, label="driven")
        predicted = tables.pivot(index="frame", columns="model", values="predicted_rad").loc[truth["frame"]]
        for number, model in enumerate(models["model"]):
            angles = predicted[model].to_numpy() if model in predicted else np.full(len(truth), np.nan)
            for start, stop in segments(track, angles):
                piece = track.path(angles, start, stop)
                panel.plot(-piece[:, 1], piece[:, 0], color=f"C{number}", linewidth=1.3, label=model)
                panel.plot(-piece[0, 1], piece[0, 0], ".", color=f"C{number}", markersize=6)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(drive, fontsize="small", loc="left")
        panel.set(xlabel="right of the start in m", ylabel="ahead of the start in m")
    labels = {text: handle for panel in panels for handle, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=6, frameon=False)
    _save(figure, out / "paths")
    drift = models.dropna(subset="test.drift_m_per_100m")
    text = ", ".join(f"{row['model']} {row['test.drift_m_per_100m']:.1f} m" for _, row in drift.iterrows())
    caption = (
        f"Figure 4 (5 in the paper). Paths from measured speed and predicted steering: {FORMULA[first['path']]}. A "
        "path restarts from the true one at each dot: at its start and at the onset of a turn. Drift per 100 m: "
        f"{text}."
    )
    return {"paths": caption}
