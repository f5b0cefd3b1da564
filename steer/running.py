"""Run a chain on a source for steer predict and steer measure, and write its results."""

from collections.abc import Callable, Generator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.base.errors import InputError
from steer.options import Output

if TYPE_CHECKING:
    from pipeline.live.frame_state import FrameState
    from pipeline.live.results import Results
    from pipeline.live.source import Source

SourcePath = Annotated[Path, typer.Argument(help="folder of a KITTI drive, folder of images, or video")]
Fov = Annotated[float | None, typer.Option(help="horizontal field of view in degrees, unless a KITTI drive")]
K = Annotated[str | None, typer.Option("--K", metavar="FX,FY,CX,CY", help="or the intrinsics in pixels")]
Calib = Annotated[Path | None, typer.Option(help="or a calib_cam_to_cam.txt")]
Fps = Annotated[float | None, typer.Option(min=0.01, max=1000, help="images per second; default: a video's own times")]
Times = Annotated[Path | None, typer.Option(help="or the images' times: seconds, one per line")]
CameraHeight = Annotated[float | None, typer.Option(min=0.3, max=5, help="of the camera over the road, metres")]
Video = Annotated[bool, typer.Option(help="write overlay.mp4")]


def write_results(
    frames: "Generator[FrameState]",
    source: "Source",
    path: Path,
    out: Path,
    names: tuple[str, ...],
    output: Output,
    *,
    wheelbase_m: float,
    warm_up: int,
    video: bool,
    finish: "Callable[[Path], None]" = lambda folder: None,
    add: "Callable[[FrameState], None]" = lambda frame: None,
) -> "Results":
    """Write the CSV file names[0], the video and what `finish` writes to its folder; `add` gets each frame."""
    from tqdm import tqdm

    from pipeline.live.overlay import Overlay
    from pipeline.live.results import COLUMNS, STEERING, VIDEO, Results, result_folder

    with ExitStack() as stack:
        folder = stack.enter_context(result_folder(out, *names, VIDEO))
        file = stack.enter_context((folder / names[0]).open("w", newline="", encoding="utf-8"))
        results, overlay = Results(file, source.name, warm_up, COLUMNS[names[0]]), None
        if video:
            overlay = Overlay(folder / VIDEO, source, wheelbase_m, predicts=names[0] == STEERING)
            stack.enter_context(overlay)
        bar = stack.enter_context(tqdm(total=source.count, unit=" frames", disable=None if output.visible else True))
        for frame in stack.enter_context(closing(frames)):
            results.add(frame)
            add(frame)
            if overlay:
                overlay.add(frame)
            bar.update()
            if results.frames % 20 == 0:
                bar.set_postfix_str(results.speed())
        if not results.frames:
            raise InputError("no frame could be read", path, "; ".join(source.notes[:1]))
        finish(folder)
    return results


def print_notes(source: "Source", results: "Results", output: Output) -> None:
    """Print gaps, notes and why motion could not be measured."""
    for before, after in results.gaps:
        output.line(f"no frames between {before} and {after}")
    for note in source.notes:
        output.line(note)
    if problems := results.problems.most_common():
        reasons = ", ".join(f"{problem} ({count})" for problem, count in problems)
        output.line(f"motion measured in {results.valid} of {results.frames} frames; not measured: {reasons}")
