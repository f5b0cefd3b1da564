"""Draw all figures of the paper that the data at hand allows, and write their captions."""

from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base import store
from pipeline.report import drawing, street_view
from pipeline.report.figures import chain, paths
from pipeline.report.judge.paths import Track
from pipeline.report.results import Results

_FOLDERS = ("ingest", "perception", "clouds/pseudo")
MAX_MODELS = 4  # models with a path in Figure 4
FORMULA = {"bicycle": "bicycle model", "paper": "the paper's formula, which takes the steering angle as heading"}
Figures = dict[str, str]
"""Name of the file without suffix → caption."""


def draw(out: Path, results: Results, data: Path) -> Figures:
    """Draw figures of the best model that predicts the current angle, from the stages' folders in `data`."""
    models = results.models
    now = models[models["line.horizon"] == 0].sort_values("test.nmse", kind="stable") if len(models) else models
    if now.empty:
        return {}
    best = now.iloc[0]
    captions = _draw_images(out, best, results.first_seed([best["model"]]), data)
    captions |= _draw_pruning(out, best, data / "evaluate" / best["model"] / "structure.json")
    captions |= _draw_paths(out, now[:MAX_MODELS], results)
    return dict(sorted(captions.items(), key=_number))


def _number(item: tuple[str, str]) -> str:
    return item[1]  # a caption begins with the number of the figure


def _draw_images(out: Path, model: pd.Series, steering: pd.DataFrame, data: Path) -> Figures:
    """Draw Figures 1 and 2, a frame's way from image to steering, and perception: each drive's sharpest left turn."""
    predicted = steering.dropna(subset=["driven_deg", "predicted_deg"])
    rows = predicted.loc[predicted.groupby("drive")["predicted_deg"].idxmax()]
    frames = rows.sort_values("predicted_deg", ascending=False)[["drive", "frame"]].to_numpy().tolist()
    views = [(drive, view) for drive, number in frames if (view := _read_view(data, drive, number))]
    if not views:
        return {}
    drive, view = views[0]
    captions = {}
    if pd.notna(model.get("variant.k")):
        variant = model["variant.k"], model["variant.keep_inter_class"]
        chain.draw_chain(out / "chain", view, steering[steering["drive"] == drive], *variant)
        captions["chain"] = (
            f"Figure 1. From image to steering: frame {view.frame} of {drive}. {model['model']} gets the graphs of "
            f"{model['line.window']} such frames, with {model['points_per_frame']:,.0f} points each."
        )
    drive, view = views[-1]
    drawing.save_png_and_svg(street_view.sheet(drive, [view]), out / "street")
    captions["street"] = f"Figure 2. {drive}, frame {view.frame}: image, depth, classes, semantic cloud from above."
    return captions


def _read_view(data: Path, drive: str, number: int) -> street_view.View | None:
    """Read a frame's image, perception and cloud; None if this machine or the drive has none."""
    files = [(data / folder / f"{drive}.h5", folder.split("/")[0]) for folder in _FOLDERS]
    if not all(path.is_file() for path, _ in files):
        return None
    images, perceived, cloud = (store.DriveReader(path, stage=stage) for path, stage in files)
    with images, perceived, cloud:
        if not all(number in file.frame for file in (images, perceived, cloud)):
            return None
        return street_view.read_view(images, perceived, cloud, number)


def _draw_pruning(out: Path, model: pd.Series, path: Path) -> Figures:
    graphs = store.read_json(path, stage=f"evaluate@{model['model']}") if path.is_file() else {}
    if not graphs:
        return {}
    drive, graph = next(iter(graphs.items()))
    xyz, cls = np.array(graph["xyz_m"], np.float32), np.array(graph["cls"], np.uint8)
    title, keep = f"{drive}, frame {graph['frame']}", model["variant.keep_inter_class"]
    chain.draw_pruning(out / "pruning", title, xyz, cls, model["variant.k"], keep)
    caption = (
        f"Figure 3. {title}, sampled to {min(chain.PRUNING_POINTS, len(xyz))} points: the graph of "
        f"{model['variant.k']} nearest neighbours before and after pruning of edges between classes to {keep:.0%}. "
        "Edges are directed, as in the paper and in all tables."
    )
    return {"pruning": caption}


def _draw_paths(out: Path, models: pd.DataFrame, results: Results) -> Figures:
    first, predictions = models.iloc[0], results.first_seed([*models["model"]])
    tracks: dict[str, Track] = {}
    predicted: dict[str, dict[str, np.ndarray]] = {model: {} for model in models["model"]}
    for drive, tables in predictions.groupby("drive", sort=False):
        own = tables.drop_duplicates("frame").sort_values("frame")
        tracks[drive] = Track(
            time_s=own["elapsed_s"].to_numpy(),
            speed_mps=own["speed_mps"].to_numpy(),
            steering_rad=np.nan_to_num(own["steering_rad"].to_numpy()),
            onsets=np.flatnonzero(own["onset"]),
            wheelbase_m=first["wheelbase_m"],
            formula=first["path"],
        )
        for model, table in tables.groupby("model"):
            predicted[model][drive] = table.set_index("frame")["predicted_rad"].reindex(own["frame"]).to_numpy()
    paths.draw(out / "paths", tracks, predicted)
    drift = [(row["model"], row["test.drift_m_per_100m"]) for _, row in models.iterrows()]
    text = ", ".join(f"{model} {metres:.1f} m" for model, metres in drift if pd.notna(metres))
    caption = (
        f"Figure 4 (5 in the paper). Paths from measured speed and predicted steering: {FORMULA[first['path']]}. A "
        "path restarts from the true one at each dot: at its start and at the onset of a turn. Drift per 100 m: "
        f"{text}."
    )
    return {"paths": caption}
