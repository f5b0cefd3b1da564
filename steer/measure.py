"""Measure a car's motion from its video.

Speed, yaw rate, curvature, steering angle and track are measured by visual odometry. This needs the encoder that
make street writes, but no steering model.

Images of another shape than the encoder's are cropped around the horizon, which is estimated from the motion. Rates
are Gaussian means over neighbouring frames, later ones included (yaw rate 0.2 s, speed 0.5 s). The steering angle
is atan(wheelbase * yaw rate / speed), left positive. A frame whose motion cannot be measured has valid = 0 and no
numbers. quality.json says how certain scale and focal length are.

\b
steer measure street.mp4 --fov 65 --out out/
steer measure data/sample/2026_01_10/2026_01_10_drive_0004_sync --encoder data/encoder
"""

from pathlib import Path
from typing import Annotated, Literal

import typer

from pipeline.base.errors import InputError
from steer import options

CAMERAS = (2, 0, 3, 1)  # of a KITTI drive, the first one with images
MIN_SPEED_MPS = 1.0  # below, the steering angle is noise


def measure(
    source: options.SourcePath,
    out: Annotated[Path, typer.Option(help="folder for motion.csv, track.png, quality.json and overlay.mp4")] = Path(
        "out"
    ),
    fov: options.Fov = None,
    k: options.K = None,
    distortion: options.Distortion = None,
    calib: options.Calib = None,
    fps: options.Fps = None,
    times: options.Times = None,
    camera_height: options.CameraHeight = None,
    wheelbase: Annotated[float, options.number(0.5, 20, "distance between the axles, metres")] = 2.7,
    max_frames: Annotated[int | None, typer.Option(min=2, max=10**9, help="measure only the first frames")] = None,
    wheel: options.Wheel = None,
    steering_ratio: options.SteeringRatio = None,
    motion: options.Motion = None,
    poses: Annotated[
        Literal["kitti", "tum"] | None, typer.Option(help="also write poses.txt, for evo and other tools")
    ] = None,
    video: options.Video = True,
    device: options.Device = None,
    encoder: Annotated[Path, typer.Option(help="folder of an encoder; make street writes the default one")] = Path(
        "weights/street"
    ),
    quiet: options.Quiet = False,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Write the measured motion and print its quality; the module's docstring is the help text."""
    from pipeline.labels.label import Car
    from pipeline.live import measure as live
    from pipeline.live.results import MEASURED_FILES, check_out, comparison_lines
    from pipeline.live.source import Clock, Lens, open_source
    from pipeline.live.truth import of_logs
    from pipeline.perception.perceive import FILE

    output, car = options.Output(quiet, as_json), Car(wheelbase, MIN_SPEED_MPS)
    encoder = options.in_project(encoder)
    if not (encoder / FILE).is_file():
        raise InputError("no encoder", encoder, "Make one for real streets: make street. Or pass --encoder")
    check_out(out, MEASURED_FILES, source)
    clock, lens = Clock(fps, times), Lens(calib, fov, k, distortion)
    truth = of_logs(wheel, steering_ratio, motion, car)
    opened = open_source(source, CAMERAS, lens, live.SIZE, False, car, clock, camera_height, level=False, truth=truth)
    show = {"video": video, "visible": output.visible}
    results, quality = live.measure(opened, encoder, car, out, max_frames, poses, **show)
    comparison = results.compare(opened.truth, "measured")
    for line in (*results.lines(opened.notes), *quality["remarks"], *comparison_lines(comparison)):
        output.line(line)
    files = [str(path) for name in MEASURED_FILES if (path := out / name).exists()]
    output.line(f"{results.valid} of {results.frames} frames measured, {results.summary()['hz']:.1f} frames/s")
    output.line(", ".join(files))
    content = {"source": opened.name, **results.summary(), "problems": results.problems, "notes": opened.notes}
    output.result(content | {"quality": quality, "comparison": comparison, "files": files})
