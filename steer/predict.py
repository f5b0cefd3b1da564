"""steer predict: the steering of a drive, a folder of images or a video, frame by frame."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Quiet, Voice

if TYPE_CHECKING:
    from pipeline.live.chain import Chain
    from pipeline.live.source import Source


def predict(
    source: Annotated[Path, typer.Argument(help="a KITTI drive's folder, a folder of images, or a video")],
    model: Annotated[Path, typer.Option(help="a trained model's folder")] = Path("data/train/sa-gnn-ncp"),
    out: Annotated[Path, typer.Option(help="gets steering.csv and overlay.mp4")] = Path("out"),
    fov: Annotated[
        float | None, typer.Option(help="degrees across the image, of a camera that is no KITTI drive")
    ] = None,
    k: Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="its intrinsics, in pixels")] = None,
    calib: Annotated[Path | None, typer.Option(help="its intrinsics, from a calib_cam_to_cam.txt")] = None,
    video: Annotated[bool, typer.Option(help="write overlay.mp4")] = True,
    encoder: Annotated[Path | None, typer.Option(help="default: data/encoder beside the model's data/train")] = None,
    params: Annotated[Path | None, typer.Option(help="default: the params.yaml beside that data")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Predict the steering angle of every frame as it comes: out/steering.csv, and a video of it.

    No LiDAR and no oxts are needed, unless the model's line takes LiDAR. Angles are in rad, left +; a frame after which
    no whole window was seen has none. A gap in the frames starts the window anew.

    steer predict data/town/2026_01_03/2026_01_03_drive_0001_sync --out out/

    steer predict street.mp4 --fov 65 --model data/train/motion
    """
    from pipeline.live import settings
    from pipeline.live.chain import Chain, takes_scans
    from pipeline.live.source import Lens, open_source
    from pipeline.train import predict as trained

    voice = Voice(quiet, as_json)
    net = trained.load(model)
    data = _data(model, encoder, params)
    of_params = settings.read(params or data.parent / "params.yaml", net.line["input"], data)
    stream = open_source(
        source,
        of_params.ingest.cameras,
        Lens(calib, fov, k),
        of_params.ingest.image_size,
        takes_scans(net, of_params),
        net.target.car,
    )
    with closing(stream.moments):
        chain = Chain(net, of_params, encoder or data / "encoder", stream.view)
        out.mkdir(parents=True, exist_ok=True)
        _write(chain, stream, out, voice, video=video)


def _data(model: Path, encoder: Path | None, params: Path | None) -> Path:
    """Return the data folder that a model lies in: data/train/<model>, or a seed's or fold's folder below it."""
    folder = model.resolve()
    for parent in folder.parents[:2]:
        if parent.name == "train":
            return parent.parent
    if encoder is None or params is None:
        raise InputError(
            f"{model} does not lie in a data/train, so nothing tells how its input was made: give --encoder (a "
            "data/encoder) and --params (the params.yaml that it was trained with)"
        )
    return params.resolve().parent / "data"


def _write(chain: "Chain", stream: "Source", out: Path, voice: Voice, *, video: bool) -> None:
    from tqdm import tqdm

    from pipeline.live.overlay import Overlay
    from pipeline.live.steering_csv import writing

    model, to, film = chain.model, out / "steering.csv", out / "overlay.mp4"
    with ExitStack() as stack:
        rows = stack.enter_context(writing(to, stream.view.name, warm_up=model.window))
        overlay = None
        if video:
            overlay = Overlay(film, stream.view, stream.fps, chain.camera_height_m, model.target.wheelbase_m)
            stack.enter_context(overlay)
        bar = stack.enter_context(tqdm(total=stream.count, unit=" frames", disable=None if voice.talks else True))
        for moment in stack.enter_context(closing(chain.angles(stream.moments))):
            rows.add(moment)
            if overlay:
                overlay.add(moment)
            bar.update()
            if rows.frames % 20 == 0:
                bar.set_postfix_str(str(rows.latency.summary()))
    for before, after in rows.gaps:
        voice.line(f"frame {after} comes after {before}: the window starts again")
    for note in stream.notes:
        voice.line(note)
    ahead = f", each {model.horizon} frames ahead" if model.horizon else ""
    voice.line(f"{model.name}: {rows.predicted} angles of {rows.frames} frames{ahead}; {rows.latency.summary()}")
    voice.line(f"{to}, {film}" if video else str(to))
    voice.result({
        "model": model.name, "source": stream.view.name, "horizon": model.horizon, **rows.summary(),
        "notes": stream.notes, "csv": str(to), "video": str(film) if video else None,
    })  # fmt: skip
