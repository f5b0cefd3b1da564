"""steer predict: predict the steering angle of a drive, a folder of images or a video, frame by frame."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.base.errors import InputError
from steer.options import Debug, Json, Output, Quiet

if TYPE_CHECKING:
    from pipeline.live.chain import Chain
    from pipeline.live.results import Results
    from pipeline.live.source import Source


def predict(
    source: Annotated[Path, typer.Argument(help="folder of a KITTI drive, folder of images, or video")],
    model: Annotated[Path, typer.Option(help="folder of a trained model")] = Path("data/train/sa-gnn-ncp"),
    out: Annotated[Path, typer.Option(help="folder for steering.csv and overlay.mp4")] = Path("out"),
    fov: Annotated[float | None, typer.Option(help="horizontal field of view in degrees, unless a KITTI drive")] = None,
    k: Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="or the intrinsics in pixels")] = None,
    calib: Annotated[Path | None, typer.Option(help="or a calib_cam_to_cam.txt")] = None,
    video: Annotated[bool, typer.Option(help="write overlay.mp4")] = True,
    encoder: Annotated[Path | None, typer.Option(help="default: data/encoder beside the model's data/train")] = None,
    params: Annotated[Path | None, typer.Option(help="default: the params.yaml beside that data")] = None,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Predict the steering angle of every frame, and write out/steering.csv and a video.

    LiDAR and oxts are needed only by models with LiDAR input. Angles are in rad, left positive; the first frames, and
    those after a gap, have none until a window is complete. Results replace those of an earlier run when the run
    succeeds; until then they are in out/.unfinished.

    steer predict data/town/2026_01_03/2026_01_03_drive_0001_sync --out out/

    steer predict street.mp4 --fov 65 --model data/train/motion
    """
    from pipeline.live import settings
    from pipeline.live.chain import Chain, needs_scans
    from pipeline.live.source import Lens, open_source
    from pipeline.train.predict import load

    trained = load(model)
    data = _data_folder(model, encoder, params)
    sections = settings.read(params or data.parent / "params.yaml", trained.line["input"], data)
    frames = open_source(
        source,
        sections.ingest.cameras,
        Lens(calib, fov, k),
        sections.ingest.image_size,
        needs_scans(trained, sections),
        trained.target.car,
    )
    with closing(frames.frames):
        chain = Chain(trained, sections, encoder or data / "encoder", frames)
        _run(chain, frames, source, out, Output(quiet, as_json), video=video)


def _data_folder(model: Path, encoder: Path | None, params: Path | None) -> Path:
    """Return the data folder of a model: data/train/<model>, or a folder of a seed or fold below it."""
    for parent in model.resolve().parents[:2]:
        if parent.name == "train":
            return parent.parent
    if encoder is None or params is None:
        fix = "Pass --encoder (a data/encoder) and --params (the params.yaml of its training)"
        raise InputError("the model is not in a data/train, so its encoder and params are unknown", model, fix)
    return params.resolve().parent / "data"


def _run(chain: "Chain", source: "Source", path: Path, out: Path, output: Output, *, video: bool) -> None:
    from tqdm import tqdm

    from pipeline.live.overlay import Overlay
    from pipeline.live.results import CSV, VIDEO, Results, result_folder

    model = chain.model
    with ExitStack() as stack:
        folder = stack.enter_context(result_folder(out))
        file = stack.enter_context((folder / CSV).open("w", newline="", encoding="utf-8"))
        results, overlay = Results(file, source.name, warm_up=model.window), None
        if video:
            overlay = Overlay(folder / VIDEO, source, chain.camera_height_m, model.target.wheelbase_m)
            stack.enter_context(overlay)
        bar = stack.enter_context(tqdm(total=source.count, unit=" frames", disable=None if output.visible else True))
        for frame in stack.enter_context(closing(chain.run(source.frames))):
            results.add(frame)
            if overlay:
                overlay.add(frame)
            bar.update()
            if results.frames % 20 == 0:
                bar.set_postfix_str(results.speed())
        if not results.frames:
            raise InputError("no frame could be read", path, "; ".join(source.notes[:1]))
    _report(chain, source, results, out, output, video=video)


def _report(chain: "Chain", source: "Source", results: "Results", out: Path, output: Output, *, video: bool) -> None:
    from pipeline.live.results import CSV, VIDEO

    model = chain.model
    for before, after in results.gaps:
        output.line(f"no frames between {before} and {after}: a new window starts")
    for note in source.notes:
        output.line(note)
    ahead = f", each {model.horizon} frames ahead" if model.horizon else ""
    output.line(f"{model.name}: {results.predicted} predictions for {results.frames} frames{ahead}; {results.speed()}")
    output.line(f"{out / CSV}, {out / VIDEO}" if video else str(out / CSV))
    output.result(
        {
            "model": model.name,
            "source": source.name,
            "horizon": model.horizon,
            **results.summary(),
            "notes": source.notes,
            "csv": str(out / CSV),
            "video": str(out / VIDEO) if video else None,
        }
    )
