"""Predict the steering angle of each frame with a trained model.

Angles are in rad, left positive. The first frames, and those after a gap, have none until a window is complete.
LiDAR scans and oxts are needed only by models with LiDAR input. steering.csv also has the measured motion, without
means over later frames: see steer measure.

Results replace those of an earlier run when the run succeeds. Until then they are in OUT/.unfinished.

\b
steer predict data/sample/2026_01_10/2026_01_10_drive_0004_sync --out out/
steer predict street.mp4 --fov 65 --model data/train/motion
"""

import os
from pathlib import Path
from typing import Annotated

import typer

from pipeline.base.errors import InputError
from steer import options

TRAINED = Path("data/train")  # where models are that are given by name


def predict(
    source: options.SourcePath,
    model: Annotated[Path, typer.Option(help="folder or name of a trained model")] = TRAINED / "sa-gnn-ncp",
    out: Annotated[Path, typer.Option(help="folder for steering.csv and overlay.mp4")] = Path("out"),
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    calib: options.Calib = None,
    fps: options.Fps = None,
    times: options.Times = None,
    camera_height: options.CameraHeight = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    motion: options.Motion = None,
    video: options.Video = True,
    device: options.Device = None,
    encoder: Annotated[
        Path | None, typer.Option(help="folder of an encoder; default: data/encoder beside the model's data/train")
    ] = None,
    params: Annotated[
        Path | None, typer.Option(help="settings of the model's data; default: params.yaml beside that data folder")
    ] = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Write the predicted angles and print their errors; the module's docstring is the help text."""
    from pipeline.live import predictor
    from pipeline.live.results import PREDICTED_FILES, STEERING, VIDEO, check_out, comparison_lines
    from pipeline.live.settings import load_settings
    from pipeline.live.source import Clock, Lens, open_source
    from pipeline.live.truth import of_logs
    from pipeline.train.predict import load

    output = options.Output(quiet, as_json)
    check_out(out, PREDICTED_FILES, source)
    named = len(model.parts) == 1 and not (model / "best.pt").is_file()
    model = options.in_project(TRAINED / model if named else model)
    trained = load(model)
    car = trained.car
    data = _data_folder(model, encoder, params)
    sections = load_settings(params or data.parent / "params.yaml", trained.entry.input, data)
    scans, size, cameras = predictor.needs_scans(trained, sections), sections.ingest.image_size, sections.ingest.cameras
    lens, height_m = Lens(calib, fov, k, distortion), camera_height or sections.perception.camera_height_m
    clock = Clock(fps, times)
    truth = of_logs(wheel, steering_ratio, motion, car)
    opened = open_source(source, cameras, lens, size, scans, car, clock, height_m, truth=truth)
    show = {"video": video, "visible": output.visible}
    results = predictor.predict(trained, sections, opened, data, encoder or data / "encoder", out, **show)
    comparison = results.compare(opened.truth, "predicted", trained.entry.horizon)
    ahead = f", each {trained.entry.horizon} frames ahead" if trained.entry.horizon else ""
    counts = f"{trained.name}: {results.predicted} predictions for {results.frames} frames{ahead}; {results.speed()}"
    for line in (*results.lines(opened.notes), counts, *comparison_lines(comparison)):
        output.line(line)
    files = {"csv": str(out / STEERING), "video": str(out / VIDEO) if video else None}
    output.line(", ".join(filter(None, files.values())))
    about = {"model": trained.name, "source": opened.name, "horizon": trained.entry.horizon}
    output.result({**about, **results.summary(), "notes": opened.notes, "comparison": comparison, **files})


def _data_folder(model: Path, encoder: Path | None, params: Path | None) -> Path:
    """Return the data folder of a model: data/train/<model>, or a folder of a seed or fold below it."""
    for parent in Path(os.path.realpath(model)).parents[:2]:
        if parent.name == "train":
            return parent.parent
    if encoder is None or params is None:
        fix = "Pass --encoder (a data/encoder) and --params (the params.yaml of its training)"
        raise InputError("the model is not in a data/train, so its encoder and params are unknown", model, fix)
    return Path(os.path.realpath(params)).parent / "data"
