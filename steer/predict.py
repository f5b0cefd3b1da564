"""Predict the steering angle of each frame with a trained model.

Angles are in rad, left positive. The first frames, and those after a gap, have none until a window is complete.
LiDAR scans and oxts are needed only by models with LiDAR input. steering.csv also has the measured motion, without
means over later frames: see steer measure.

\b
steer predict street.mp4 --fov 65 --model runs/monday/data/train/motion
steer predict data/sample/2026_01_18/2026_01_18_drive_0004_sync --model models/steering/sample
"""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.base.errors import InputError
from steer import options

SAMPLE = options.CHECKOUT / "models/steering/sample"  # of rendered streets


def predict(
    source: options.SourcePath,
    model: Annotated[Path | None, typer.Option(help="folder of a trained model, or runs/NAME")] = None,
    out: options.Out = None,
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    fisheye: options.Fisheye = None,
    fps: options.Fps = None,
    times: options.Times = None,
    camera_height: options.CameraHeight = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    motion: options.Motion = None,
    offset: options.Offset = 0.0,
    video: options.Video = True,
    encoder: Annotated[
        Path | None, typer.Option(help="folder of an encoder; default: data/encoder beside the model's data/train")
    ] = None,
) -> None:
    """Write the predicted angles and print their errors; the module's docstring is the help text."""
    from pipeline.datasets.recording import Capture
    from pipeline.media.log import Logs
    from pipeline.train.predict import load
    from pipeline.video import predict as video_predict
    from pipeline.video.source import open_source

    model = _folder(model)
    logs = Logs.read(wheel, steering_ratio, motion, offset)
    trained, encoder = load(model), encoder or _encoder_beside(model)
    capture = Capture(fov, k, distortion, fisheye, fps, times)
    height_m = camera_height or trained.settings["perception"]["camera_height_m"]
    opened = open_source(source, video_predict.reading(trained), height_m, logs, trained.fps, capture)
    lines, files = video_predict.predict(trained, opened, out, encoder, video=video)
    print(f"{trained.name} was trained on {len(trained.drives)} drives: {trained.drives[0]} to {trained.drives[-1]}")
    print(*opened.notes, *lines, ", ".join(map(str, files)), sep="\n")


def _folder(model: Path | None) -> Path:
    """Return the folder of a model. Raises InputError if there is none, or a run has several."""
    if model is None:
        fix = "Measure the angle: steer measure (nmse 0.008 on real drives). Or name a network of yours. That of "
        fix += "--model models/steering/sample has seen rendered streets only (nmse 1.22 on a real drive)"
        raise InputError("no network for real streets is included", "--model", fix)
    model = options.here_or_in_checkout(model)
    networks = sorted(path.parent for path in (model / "data/train").glob("*/best.pt"))
    if len(networks) > 1:
        raise InputError("has several models", model, f"Pass one as --model: {', '.join(map(str, networks))}")
    return networks[0] if networks else model


def _encoder_beside(model: Path) -> Path:
    """Return data/encoder of a model data/train/<model>, or of a folder of a seed or fold below it; or the sample's."""
    if model.resolve() == SAMPLE:
        return options.CHECKOUT / "models/encoder/sample"
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent / "encoder"
    raise InputError("the model is not in a data/train", model, "Pass --encoder, the folder of its encoder")
