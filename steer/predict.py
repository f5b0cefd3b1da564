"""Predict steering on the frames of a measured source with a trained model.

The file of a model has the settings of all stages before its training, so params.yaml is not read.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.hashes import file_hash
from pipeline.base.params import RATE_TOLERANCE
from pipeline.camera.pinhole import MAX_DEPTH_M, depth_limit
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.encoder.encoder_file import FILE
from pipeline.graphs import graph_file
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant
from pipeline.ingest.settings import Reading
from pipeline.labels.ahead import path_ahead
from pipeline.motion.motion_file import open_motion
from pipeline.perception.settings import Perception
from pipeline.report.street_view import path_steps
from pipeline.train.trained import Trained
from steer.chain import INGEST, MOTION, PERCEPTION, Source
from steer.outcome import Results

# Longest time in seconds for which the car may stand on the path that is drawn.
MAX_STAND_S = 5.0


def reading_settings(model: Trained) -> Reading:
    """Return the settings for reading a source for a model. Damaged images are left out."""
    lidar = model.settings["graphs"]["source"] == "clouds/lidar"
    return Reading.model_validate(model.settings["ingest"] | {"on_damaged": "skip", "lidar": lidar})


def perception_settings(model: Trained) -> Perception:
    """Return the settings of depth and classes of a model."""
    # A model of images without motion, which depend on no encoder, has no such settings.
    recorded = model.settings.get("perception", {"batch": 4}).items()
    # Settings that are no longer part of the section were null.
    return Perception.model_validate({k: v for k, v in recorded if v is not None})


def adapt_source(model: Trained, source: Source) -> Source:
    """Return a source with the model's camera height if its own is not known, and notes.

    Raises InputError if it lacks the scans that the model needs.
    """
    has_scans = source.files.scans and source.camera.T_cam_velo is not None
    if reading_settings(model).lidar and not has_scans:
        problem = f"model {model.name} needs LiDAR scans"
        raise InputError(problem, source.name, "Choose a model without them")

    height_m = model.settings.get("camera_height_m")
    if height_m and not source.camera.height_known:
        source = source.at_height(height_m)
        note = f"camera {height_m:g} m over the road, as in the model's training drives"
        source.drive.notes.insert(0, note)
    drives = model.drives[0]
    if len(model.drives) > 1:
        drives = f"{len(model.drives)} drives: {drives} to {model.drives[-1]}"
    source.drive.notes.insert(0, f"{model.name} was trained on {drives}")
    return source


def add_prediction(model: Trained, source: Source, work: Path, results: Results) -> None:
    """Add the predictions of a model for the files of :func:`run_chain` to the results.

    They become the columns ``predicted_COLUMN``, and their angle ``predicted_rad``. If they lie
    ahead of the car, the path that the car took is added, too.
    """
    # Frames with a scan but without an image have a graph, but no motion, and are left out.
    with (
        graph_file.open_graphs(_make_graphs(model, source, work)) as graphs,
        open_motion(work / MOTION) as motion,
    ):
        by_frame = pd.DataFrame(model.predict(graphs, motion), graphs.frame)
    values = by_frame.reindex(results.table["frame"]).to_numpy()

    quantity = model.quantity
    results.table["predicted_rad"] = quantity.angle_rad(values)
    for name, column in zip(quantity.columns, values.T, strict=True):
        results.table[f"predicted_{name}"] = column
    if quantity.is_ahead:
        paths = {"predicted": quantity.curvature(values), **taken_path(results, quantity.edges_m)}
        for name, path_1pm in paths.items():
            results.paths[name] = path_steps(path_1pm.T, quantity.edges_m)

    note = f"{model.name}: {np.isfinite(values[:, 0]).sum()} predictions for {len(values)} frames"
    if model.entry.horizon:
        note += f", each {model.entry.horizon} frames ahead"
    results.notes.append(note)


def taken_path(results: Results, edges_m: Sequence[float]) -> dict[str, np.ndarray]:
    """Return the path that the car took: curvatures [F,R] in the ranges between `edges_m` [R+1].

    Its name is driven if it is by recorded speeds, otherwise measured. Unknown curvatures are NaN.
    """
    name = "measured"
    labels = results.measured
    if np.isfinite(results.driven.speed_mps).any():
        name = "driven"
        labels = results.driven
    table = results.table
    taken_1pm, valid = path_ahead(table["frame"], table["time_s"], labels, edges_m, MAX_STAND_S)
    return {name: np.where(valid, taken_1pm, np.nan)}


def _make_graphs(model: Trained, source: Source, work: Path) -> Path:
    """Write the input of the model from the files of :func:`run_chain`, and return its path."""
    variant = Variant.model_validate(model.settings["graphs"])
    ingest = work / INGEST
    graphs = work / "graphs.h5"
    images_or_points = ingest
    if variant.kind != "image":
        images_or_points = work / "clouds.h5"
        kind = variant.source.removeprefix("clouds/")
        settings = _cloud_settings(model, source)
        clouds_drive(images_or_points, kind, ingest, work / PERCEPTION, settings)
    graphs_drive(graphs, images_or_points, variant)
    return graphs


def _cloud_settings(model: Trained, source: Source) -> Clouds:
    """Return the model's settings of clouds, with a larger depth limit for a longer lens."""
    settings = Clouds.model_validate(model.settings["clouds"])
    limit_m = depth_limit(source.camera)
    if limit_m <= MAX_DEPTH_M:
        return settings
    return settings.model_copy(update={"max_depth_m": max(settings.max_depth_m, limit_m)})


def find_differences(
    model: Trained, source: Source, encoder: Path, time_s: np.ndarray
) -> Iterator[str]:
    """Yield doubts where a source or an encoder differs from those of the training."""
    if model.datasets == ["sample"] and source.drive.dataset != "sample":
        fitted = f"{model.name} was fitted to the rendered sample alone"
        yield f"{fitted}, so expect wrong angles on real streets"

    if len(time_s) > 1:
        fps = 1 / float(np.median(np.diff(time_s)))
        if abs(fps / model.fps - 1) > RATE_TOLERANCE:
            yield f"{model.name} was fitted to {model.fps:.1f} frames/s, got {fps:.1f}"

    if source.name in model.drives:
        yield f"{model.name} was trained on {source.name}: on other streets its error is larger"

    fitted_with = model.settings.get("encoder")
    if fitted_with and file_hash(encoder / FILE) != fitted_with["sha256"]:
        yield f"{model.name} was fitted to depth and classes of another encoder than {encoder}"
