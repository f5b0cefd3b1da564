"""Predict steering on the frames of a source with a trained model, which knows the settings of its own chain."""

from pathlib import Path

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.resume import file_hash
from pipeline.graphs import graph_file
from pipeline.graphs.cloud import clouds_drive
from pipeline.graphs.frame_graph import graphs_drive
from pipeline.perception.perceive import weights_file
from pipeline.settings.clouds import Clouds
from pipeline.settings.graphs import Variant
from pipeline.settings.ingest import SAMPLE, Reading
from pipeline.settings.perception import Perception
from pipeline.train.predict import Trained
from pipeline.video.pictures import draw_track, write_overlay
from pipeline.video.results import Logs, Results
from pipeline.video.source import INGEST, MOTION, PERCEPTION, Source, publish, run_chain, work_folder

CLOUDS, GRAPHS = "clouds.h5", "graphs.h5"
TOLERANCE = 0.2  # relative, of the frame rate


def reading(model: Trained) -> Reading:
    """Return what the model's chain reads of a recording; damaged images are left out."""
    variant = model.settings["graphs"]
    lidar = variant["source"] == "clouds/lidar"
    return Reading.model_validate(model.settings["ingest"] | {"on_damaged": "skip", "lidar": lidar})


def predict(
    model: Trained, source: Source, out: Path | None, encoder: Path, logs: Logs, *, video: bool, visible: bool
) -> tuple[Results, list[Path]]:
    """Write steering.csv, track.png and overlay.mp4; return results and files.

    Args:
        model: from :func:`pipeline.train.predict.load`.
        source, out, encoder, logs, video, visible: as of :func:`pipeline.video.measure.measure`.
    Raises:
        InputError: the source lacks an input of the model, `out` is not free, no frame can be read, or a log is
            unusable.
    """
    settings = model.settings
    variant, perception = Variant.model_validate(settings["graphs"]), Perception.model_validate(settings["perception"])
    lidar = variant.source == "clouds/lidar"
    if lidar and not (source.drive and source.drive.scans and source.camera.T_cam_velo is not None):
        raise InputError(f"model {model.name} needs LiDAR scans", source.name, "Choose a model without them")
    source.notes.extend(f"warning: model {model.name}: {text}" for text in _differences(model, source, encoder))
    work = work_folder(out, source, encoder, settings=settings)
    run_chain(source, work, reading(model), perception, encoder, visible=visible)
    clouds = work / (INGEST if variant.kind == "image" else CLOUDS)
    if not clouds.exists():
        kind = variant.source.removeprefix("clouds/")
        clouds_drive(clouds, kind, work / INGEST, work / PERCEPTION, Clouds.model_validate(settings["clouds"]))
    if not (work / GRAPHS).exists():
        graphs_drive(work / GRAPHS, clouds, work / MOTION, variant)
    with graph_file.open_graphs(work / GRAPHS) as graphs:
        results = Results.read(source, work, model.car, logs, look_ahead=False, frame=graphs.frame)
        rows = np.isin(graphs.frame, results.table["frame"])  # a frame with a scan may lack an image
        mean, sigma = (None if values is None else values[rows] for values in model.predict(graphs)[:2])
    assert mean is not None
    results.table["predicted_rad"] = np.full(len(mean), np.nan) if model.ahead_m else mean[:, 0]
    if model.ahead_m:
        results.ahead_m, results.path_1pm, results.path_sigma_1pm = model.ahead_m, mean, sigma
    elif sigma is not None:
        results.table["sigma_rad"] = sigma[:, 0]
    results.write_csv(work / "new/steering.csv")
    draw_track(work / "new/track.png", results)
    if video:
        write_overlay(work / "new/overlay.mp4", source, results, model.car.wheelbase_m)
    return results, publish(work)


def _differences(model: Trained, source: Source, encoder: Path) -> list[str]:
    """Return where a source or an encoder differs from what the model was fitted to."""
    texts = []
    if all(drive.startswith(SAMPLE) for drive in model.drives) and not source.name.startswith(SAMPLE):
        texts.append("it was fitted to the rendered sample alone, so expect wrong angles on real streets")
    if source.fps and abs(source.fps / model.fps - 1) > TOLERANCE:
        texts.append(f"it was fitted to {model.fps:.1f} frames/s, got {source.fps:.1f}")
    if file_hash(weights_file(encoder)) != model.settings["encoder"]["sha256"]:
        texts.append(f"it was fitted to depth and classes of another encoder than {encoder}")
    return texts
