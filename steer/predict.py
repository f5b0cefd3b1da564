"""steer predict: predict the steering angle of a drive, a folder of images or a video, frame by frame."""

from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Output, Quiet
from steer.running import Calib, CameraHeight, Fov, Fps, K, SourcePath, Times, Video, print_notes, write_results


def predict(
    source: SourcePath,
    model: Annotated[Path, typer.Option(help="folder of a trained model")] = Path("data/train/sa-gnn-ncp"),
    out: Annotated[Path, typer.Option(help="folder for steering.csv and overlay.mp4")] = Path("out"),
    fov: Fov = None,
    k: K = None,
    calib: Calib = None,
    fps: Fps = None,
    times: Times = None,
    camera_height: CameraHeight = None,
    video: Video = True,
    encoder: Annotated[Path | None, typer.Option(help="default: data/encoder beside the model's data/train")] = None,
    params: Annotated[Path | None, typer.Option(help="default: the params.yaml beside that data")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Predict the steering angle of every frame, and write out/steering.csv and a video.

    LiDAR and oxts are needed only by models with LiDAR input. Angles are in rad, left positive; the first frames, and
    those after a gap, have none until a window is complete. The columns after latency_ms are measured motion, without
    smoothing: see steer measure. Results replace those of an earlier run when the run succeeds; until then they are in
    out/.unfinished.

    steer predict data/town/2026_01_03/2026_01_03_drive_0001_sync --out out/

    steer predict street.mp4 --fov 65 --model data/train/motion
    """
    from pipeline.encoder.perceive import FILE
    from pipeline.live import settings
    from pipeline.live.chain import Chain
    from pipeline.live.course import add_courses
    from pipeline.live.predictor import Predictor, differences, motion_kinds, needs_scans
    from pipeline.live.results import STEERING, VIDEO
    from pipeline.live.source import Clock, Lens, open_source
    from pipeline.train.predict import load

    output, trained = Output(quiet, as_json), load(model)
    data = _data_folder(model, encoder, params)
    sections = settings.read(params or data.parent / "params.yaml", trained.line["input"], data)
    scans, size, car = needs_scans(trained, sections), sections.ingest.image_size, trained.target.car
    height_m = camera_height or sections.perception.camera_height_m
    clock, cameras = Clock(fps, times), sections.ingest.cameras
    frames = open_source(source, cameras, Lens(calib, fov, k), size, scans, car, clock, height_m)
    frames.notes += differences(trained, frames, settings.focal_by_width(data))
    folder, kinds = encoder or data / "encoder", motion_kinds(trained, sections)
    network = folder if (folder / FILE).is_file() or sections.variant.source != "ingest" or "visual" in kinds else None
    with closing(frames.frames):
        kinds |= {"visual"} if network else set()
        chain = Chain(frames, size, network, kinds, sections.perception, sections.motion.road_scale)
        predictor = Predictor(trained, sections, frames, chain.camera)
        measured = add_courses(predictor.run(chain.run(frames.frames)), car, smooth=False)
        run: dict[str, Any] = {"wheelbase_m": car.wheelbase_m, "warm_up": trained.window, "video": video}
        results = write_results(measured, frames, source, out, (STEERING,), output, **run)
    print_notes(frames, results, output)
    ahead = f", each {trained.horizon} frames ahead" if trained.horizon else ""
    output.line(
        f"{trained.name}: {results.predicted} predictions for {results.frames} frames{ahead}; {results.speed()}"
    )
    output.line(f"{out / STEERING}, {out / VIDEO}" if video else str(out / STEERING))
    output.result(
        {
            "model": trained.name,
            "source": frames.name,
            "horizon": trained.horizon,
            **results.summary(),
            "notes": frames.notes,
            "csv": str(out / STEERING),
            "video": str(out / VIDEO) if video else None,
        }
    )


def _data_folder(model: Path, encoder: Path | None, params: Path | None) -> Path:
    """Return the data folder of a model: data/train/<model>, or a folder of a seed or fold below it."""
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent
    if encoder is None or params is None:
        fix = "Pass --encoder (a data/encoder) and --params (the params.yaml of its training)"
        raise InputError("the model is not in a data/train, so its encoder and params are unknown", model, fix)
    return params.resolve().parent / "data"
