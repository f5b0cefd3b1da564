"""Predict steering on the frames of a source with a trained model.

The file of a model has the settings of all stages before its training, so params.yaml is not read.
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
    """Return the settings for reading a source for a model. Damaged images are left out."""
    lidar = model.settings["graphs"]["source"] == "clouds/lidar"
    return Reading.model_validate(model.settings["ingest"] | {"on_damaged": "skip", "lidar": lidar})


def predict(
    model: Trained, source: Source, out: Path | None, encoder: Path, *, video: bool
) -> Outcome:
    """Predict the angles of a source, and write steering.csv, track.png and overlay.mp4.

    Arguments are those of :func:`steer.measure.measure`. Raises InputError if no frame can be read,
    a log is unusable, or the source lacks an input of the model.
    """
    # Settings that are no longer part of the section were null.
    recorded = model.settings["perception"].items()
    perception = Perception.model_validate({k: v for k, v in recorded if v is not None})
    car = model.quantity.car
    has_scans = source.files and source.files.scans and source.camera.T_cam_velo is not None
    if reading(model).lidar and not has_scans:
        problem = f"model {model.name} needs LiDAR scans"
        raise InputError(problem, source.name, "Choose a model without them")

    with run_chain(source, out, reading(model), perception, encoder) as work:
        with graph_file.open_graphs(_make_graphs(model, source, work)) as graphs:
            results = Results.read(source, work, car, smooth=False, frame=graphs.frame)
            # Frames with a scan but without an image have a graph, but no motion, and are left out.
            rows = np.isin(graphs.frame, results.table["frame"])
            prediction = model.predict(graphs)[rows]
        results.add_prediction(model.quantity, prediction)

        horizon = model.entry.horizon
        notes = [*source.drive.notes, *results.lines(results.compare("predicted", horizon))]
        predictions = f"{np.isfinite(prediction[:, 0]).sum()} predictions"
        note = f"{model.name}: {predictions} for {len(prediction)} frames"
        if horizon:
            note += f", each {horizon} frames ahead"
        notes.append(note)
        results.doubts += _differences(model, source, encoder, results.table["time_s"])
    files = publish(out, "steering.csv", results, source, car.wheelbase_m, video=video)
    return Outcome(results.columns(), notes, results.doubts, files)


def _make_graphs(model: Trained, source: Source, work: Path) -> Path:
    """Write the input of the model from the files of :func:`run_chain`, and return its path."""
    variant = Variant.model_validate(model.settings["graphs"])
    ingest = work / INGEST
    graphs = work / "graphs.h5"
    images_or_points = ingest
    if variant.kind != "image":
        images_or_points = work / "clouds.h5"
        kind = variant.source.removeprefix("clouds/")
        settings = _clouds(model, source)
        clouds_drive(images_or_points, kind, ingest, work / PERCEPTION, settings)
    graphs_drive(graphs, images_or_points, work / MOTION, variant)
    return graphs


def _clouds(model: Trained, source: Source) -> Clouds:
    """Return the model's settings of clouds, with a larger depth limit for a longer lens."""
    settings = Clouds.model_validate(model.settings["clouds"])
    limit_m = depth_limit(source.camera)
    if source.files or limit_m <= MAX_DEPTH_M:
        return settings
    return settings.model_copy(update={"max_depth_m": max(settings.max_depth_m, limit_m)})


def _differences(
    model: Trained, source: Source, encoder: Path, time_s: np.ndarray
) -> Iterator[str]:
    """Yield doubts where a source or an encoder differs from those of the training."""
    if model.datasets == ["sample"] and source.drive.dataset != "sample":
        fitted = f"{model.name} was fitted to the rendered sample alone"
        yield f"{fitted}, so expect wrong angles on real streets"

    # A recording has been resampled to the rate of the training, but not a KITTI drive.
    if source.files and len(time_s) > 1:
        fps = 1 / float(np.median(np.diff(time_s)))
        if abs(fps / model.fps - 1) > RATE_TOLERANCE:
            yield f"{model.name} was fitted to {model.fps:.1f} frames/s, got {fps:.1f}"

    # The drive of KITTI, or the first part of the recording, that was imported by this name.
    if any(drive.removesuffix("-train") == source.name for drive in model.drives):
        yield f"{model.name} was trained on {source.name}: on other streets its error is larger"

    if file_hash(encoder / FILE) != model.settings["encoder"]["sha256"]:
        yield f"{model.name} was fitted to depth and classes of another encoder than {encoder}"
