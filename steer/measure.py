"""steer measure: measure the motion of a car from its video, without a trained steering model."""

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Output, Quiet
from steer.running import Calib, CameraHeight, Fov, Fps, K, SourcePath, Times, Video, print_notes, write_results

if TYPE_CHECKING:
    from pipeline.live.frame_state import FrameState

CAMERAS = (2, 0, 3, 1)  # of a KITTI drive, the first one with images
SIZE = (192, 640)  # of images, as the depth network was trained
MIN_SPEED_MPS = 1.0  # below, the steering angle is noise


def measure(
    source: SourcePath,
    out: Annotated[Path, typer.Option(help="folder for motion.csv, track.png, quality.json, overlay.mp4")] = Path(
        "out"
    ),
    fov: Fov = None,
    k: K = None,
    calib: Calib = None,
    fps: Fps = None,
    times: Times = None,
    camera_height: CameraHeight = None,
    wheelbase: Annotated[float, typer.Option(min=0.5, max=20, help="of the car, metres")] = 2.7,
    max_frames: Annotated[int | None, typer.Option(min=2, help="measure only these first frames")] = None,
    video: Video = True,
    encoder: Annotated[Path, typer.Option(help="folder of an encoder; make street makes the default")] = Path(
        "weights/street"
    ),
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Measure speed, yaw rate, curvature, steering angle and track of a video, by visual odometry.

    Needs an encoder, but no steering model: make street. Images of other shapes are cropped around the horizon, which
    is found from the motion. Rates are means over neighbouring frames, later ones included (Gaussian: yaw rate 0.2 s,
    speed 0.5 s). The steering angle is atan(wheelbase * yaw rate / speed), left positive. A frame whose motion cannot
    be measured has valid = 0 and no numbers. quality.json describes how certain scale and focal length are.

    steer measure street.mp4 --fov 65 --out out/

    steer measure data/town/2026_01_03/2026_01_03_drive_0001_sync --encoder data/encoder
    """
    from pipeline.base import store
    from pipeline.encoder.perceive import FILE
    from pipeline.fitting.prefetch import prefetch
    from pipeline.live import track_picture
    from pipeline.live.chain import Chain
    from pipeline.live.course import add_courses
    from pipeline.live.quality import Quality
    from pipeline.live.results import MOTION, QUALITY, TRACK, VIDEO
    from pipeline.live.source import Clock, Lens, open_source
    from pipeline.sections.perception import Perception
    from pipeline.train.windows import Car

    output, car = Output(quiet, as_json), Car(wheelbase, MIN_SPEED_MPS)
    if not (encoder / FILE).is_file():
        raise InputError("no encoder", encoder, "Make one for real streets: make street. Or pass --encoder")
    clock, lens = Clock(fps, times), Lens(calib, fov, k)
    frames = open_source(source, CAMERAS, lens, SIZE, False, car, clock, camera_height, level=False)
    names, courses = (MOTION, TRACK, QUALITY), []
    with closing(frames.frames):
        chain = Chain(frames, SIZE, encoder, {"visual"}, Perception(batch=1), road_scale=frames.height_m is not None)
        assert chain.odometry
        quality = Quality(chain.odometry, frames)
        measured = prefetch(quality.watch(chain.run(frames.frames), max_frames), 1)

        def add(frame: "FrameState") -> None:
            if frame.course:
                courses.append((frame.time_s, frame.course))

        def finish(folder: Path) -> None:
            store.write_json(folder / QUALITY, quality.summary())
            track_picture.draw(folder / TRACK, frames.name, courses)

        run: dict[str, Any] = {"wheelbase_m": wheelbase, "warm_up": 1, "video": video, "add": add, "finish": finish}
        results = write_results(add_courses(measured, car, smooth=True), frames, source, out, names, output, **run)
    print_notes(frames, results, output)
    summary = quality.summary()
    for remark in summary["remarks"]:
        output.line(remark)
    files = [out / name for name in (*names, *([VIDEO] if video else []))]
    output.line(f"{results.valid} of {results.frames} frames measured, {results.summary()['hz']:.1f} frames/s")
    output.line(", ".join(map(str, files)))
    content = {"source": frames.name, **results.summary(), "problems": results.problems, "notes": frames.notes}
    output.result(content | {"quality": summary, "files": [str(file) for file in files]})
