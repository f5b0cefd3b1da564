"""Measure the motion and the course of a car from the frames of its camera, by visual odometry.

Rates and angles are in rad (curvature in 1/m), left positive. A frame whose motion cannot be measured has valid = 0 and
no numbers. quality.json says how certain scale and focal length are.

\b
steer measure street.mp4 --fov 65
steer measure data/sample/2026_01_10/2026_01_10_drive_0004_sync --encoder data/encoder
"""

from pathlib import Path
from typing import Annotated, Literal

import typer

from pipeline.base.errors import InputError
from steer import options

MIN_SPEED_MPS = 1.0  # below, the steering angle is noise


def measure(
    source: options.SourcePath,
    out: options.Out = None,
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    calib: options.Calib = None,
    fps: options.Fps = None,
    times: options.Times = None,
    camera_height: options.CameraHeight = None,
    wheelbase: Annotated[float, options.number(0.5, 20, "distance between the axles, metres")] = 2.7,
    max_frames: Annotated[int | None, typer.Option(min=2, help="measure only the first frames")] = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    motion: options.Motion = None,
    poses: Annotated[
        Literal["kitti", "tum"] | None, typer.Option(help="also write poses.txt, for evo and other tools")
    ] = None,
    video: options.Video = True,
    encoder: Annotated[Path, typer.Option(help="folder of an encoder; make street writes the default one")] = Path(
        "weights/street"
    ),
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Write the measured motion and print its quality; the module's docstring is the help text."""
    from pipeline.base.outputs import WORK, claim
    from pipeline.labels.label import Car
    from pipeline.perception.perceive import FILE
    from pipeline.video import measure as video_measure
    from pipeline.video.chain import publish
    from pipeline.video.source import Clock, Lens, open_source
    from pipeline.video.truth import Logs

    output, car = options.Output(quiet, as_json), Car(wheelbase, MIN_SPEED_MPS)
    encoder = options.in_project(encoder)
    if not (encoder / FILE).is_file():
        raise InputError("no encoder", encoder, "Make one for real streets: make street. Or pass --encoder")
    lens, clock, logs = Lens(calib, fov, k, distortion), Clock(fps, times), Logs.read(wheel, steering_ratio, motion)
    opened = open_source(source, video_measure.CAMERAS, lens, clock, camera_height, max_frames)
    key = opened.key(encoder=encoder, distortion=distortion)
    out = claim(out, opened.name, key)
    work = out / WORK / key
    show = {"video": video, "visible": output.visible}
    results, quality = video_measure.measure(opened, work, encoder, car, logs, poses, **show)
    comparison = results.compare("measured")
    for line in (*opened.notes, *results.lines(comparison), *quality["remarks"]):
        output.line(line)
    files = publish(work, out)
    output.line(", ".join(map(str, files)))
    content = {"source": opened.name, **results.summary(), "notes": opened.notes, "quality": quality}
    output.result({**content, "comparison": comparison, "files": files})
