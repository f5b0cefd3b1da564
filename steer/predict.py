"""Predict steering on the frames of a source with a trained model, which knows the settings of its
own chain.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.params import RATE_TOLERANCE
from pipeline.base.resume import file_hash
from pipeline.camera.lens import MAX_DEPTH_M, depth_limit
from pipeline.clouds.cloud import clouds_drive
from pipeline.clouds.settings import Clouds
from pipeline.encoder.encoder_file import FILE
from pipeline.graphs import graph_file
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.graphs.settings import Variant
from pipeline.ingest.settings import Reading
from pipeline.perception.settings import Perception
from pipeline.train.trained import Trained
from steer.chain import INGEST, MOTION, PERCEPTION, Source, run_chain
from steer.outcome import Outcome, Results
from steer.pictures import publish


def reading(model: Trained) -> Reading:
    """Return what the model's chain reads of a recording; damaged images are left out."""
    lidar = model.settings["graphs"]["source"] == "clouds/lidar"
    return Reading.model_validate(model.settings["ingest"] | {"on_damaged": "skip", "lidar": lidar})


def predict(
    model: Trained, source: Source, out: Path | None, encoder: Path, *, video: bool
) -> Outcome:
    """Write steering.csv, track.png and overlay.mp4; arguments as of :func:`steer.measure.measure`.

    Raises InputError if no frame can be read, a log is unusable, or the source lacks an input of
    the model.
    """
    settings = model.settings
    variant, perception = (
        Variant.model_validate(settings["graphs"]),
        Perception.model_validate(settings["perception"]),
    )
    if reading(model).lidar and not (
        source.files and source.files.scans and source.camera.T_cam_velo is not None
    ):
        raise InputError(
            f"model {model.name} needs LiDAR scans", source.name, "Choose a model without them"
        )
    with run_chain(source, out, reading(model), perception, encoder) as work:
        graph, clouds = work / "graphs.h5", work / INGEST
        if variant.kind != "image":
            kind, clouds = variant.source.removeprefix("clouds/"), work / "clouds.h5"
            clouds_drive(clouds, kind, work / INGEST, work / PERCEPTION, _clouds(model, source))
        graphs_drive(graph, clouds, work / MOTION, variant)
        with graph_file.open_graphs(graph) as graphs:
            results = Results.read(source, work, model.car, look_ahead=False, frame=graphs.frame)
            # a frame with a scan may lack an image
            rows = np.isin(graphs.frame, results.table["frame"])
            prediction = model.predict(graphs)[rows]
        frames, horizon = len(prediction), model.entry.horizon
        results.table["predicted_rad"] = (
            np.full(frames, np.nan) if model.ahead_m else prediction[:, 0]
        )
        if model.ahead_m:
            results.ahead_m, results.path_1pm = model.ahead_m, prediction
        ahead = f", each {horizon} frames ahead" if horizon else ""
        predicted = (
            f"{model.name}: {np.isfinite(prediction[:, 0]).sum()} predictions for {frames} "
            f"frames{ahead}"
        )
        results.doubts += _differences(model, source, encoder, results.table["time_s"])
        lines = [
            *source.drive.notes,
            *results.lines(results.compare("predicted", horizon)),
            predicted,
        ]
    files = publish(out, "steering.csv", results, source, model.car.wheelbase_m, video=video)
    return Outcome(results.columns(), lines, results.doubts, files)


def _clouds(model: Trained, source: Source) -> Clouds:
    """Return the model's settings of clouds; a recording by a longer lens than the model's has
    deeper clouds.
    """
    settings, limit_m = Clouds.model_validate(model.settings["clouds"]), depth_limit(source.camera)
    if source.files or limit_m <= MAX_DEPTH_M:
        return settings
    return settings.model_copy(update={"max_depth_m": max(settings.max_depth_m, limit_m)})


def _differences(
    model: Trained, source: Source, encoder: Path, time_s: np.ndarray
) -> Iterator[str]:
    """Yield where a source or an encoder differs from what the model was fitted to."""
    if model.datasets == ["sample"] != [source.drive.dataset]:
        yield (
            f"{model.name} was fitted to the rendered sample alone, so expect wrong angles on "
            "real streets"
        )
    step_s = (
        float(np.median(np.diff(time_s))) if source.files and len(time_s) > 1 else 1 / model.fps
    )
    if abs(1 / step_s / model.fps - 1) > RATE_TOLERANCE:  # other sources have been resampled
        yield f"{model.name} was fitted to {model.fps:.1f} frames/s, got {1 / step_s:.1f}"
    if file_hash(encoder / FILE) != model.settings["encoder"]["sha256"]:
        yield f"{model.name} was fitted to depth and classes of another encoder than {encoder}"
