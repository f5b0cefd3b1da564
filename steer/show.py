"""steer show: what an artefact holds, where it came from, and a picture of a frame."""

from pathlib import Path
from typing import Annotated, Any

import typer

from steer.options import Debug, Json, Quiet, Voice


def show(
    path: Annotated[Path, typer.Argument(metavar="FILE_OR_FOLDER", help="an artefact of a stage, or a raw drive")],
    frame: Annotated[int | None, typer.Option(min=0, help="this frame's numbers, and a picture of it")] = None,
    out: Annotated[Path | None, typer.Option(help="the picture, a PNG; default NAME-frame-N.png here")] = None,
    ply: Annotated[
        Path | None, typer.Option(help="write the frame's points to this PLY file, in class colours")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="turn the frame's points in Open3D's viewer")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """What an artefact of any stage holds, and where it came from, back to the raw drive.

    Where it came from is read from the dvc.lock of the project in which it lies: each stage's command and settings,
    hashes of what it read, and whether the code there is still that which made it.

        steer show data/graphs/semantic/2026_01_03_drive_0001.h5

        steer show data/clouds/pseudo/2026_01_03_drive_0001.h5 --frame 40 --ply frame.ply

        steer show data/train/sa-gnn-ncp --json

        steer show data/raw/2011_09_26/2011_09_26_drive_0052_sync --frame 10 --out street.png
    """
    from pipeline.inspect import artefact, lineage, origin, words

    voice = Voice(quiet, as_json)
    told = artefact.describe(path)
    chain, raw = lineage.chain(path), origin.of_drives(path, told.get("made_of", []))
    for line in words.artefact(told):
        voice.line(line)
    if told["kind"] not in ("raw drive", "folder of raw drives"):
        for line in words.provenance(chain, raw):
            voice.line(line)
    shown = _show_frame(path, frame, out, ply, view, voice) if (frame is not None or out or ply or view) else {}
    voice.result({**told, "provenance": {**chain, "raw": raw}, **shown})


def _show_frame(
    path: Path, frame: int | None, out: Path | None, ply: Path | None, view: bool, voice: Voice
) -> dict[str, Any]:
    """Say a frame's numbers, write what is asked for, and return what was."""
    from pipeline.inspect import frame_picture, frame_view, points

    seen = frame_view.read(path, frame)
    name = path.resolve().stem
    title = f"{Path(*path.absolute().parts[-3:])}, frame {seen.frame}"
    voice.line(f"frame {seen.frame}: " + ", ".join(f"{key} {value:.6g}" for key, value in seen.values.items()))
    written: dict[str, Any] = {"frame": seen.frame, "values": seen.values}
    if out or (seen.drawable and frame is not None):
        picture = out or Path(f"{name}-frame-{seen.frame}.png")
        frame_picture.draw(picture, title, seen)
        voice.line(f"picture: {picture}")
        written["picture"] = str(picture)
    elif frame is not None:
        voice.line("picture: none, as these are numbers alone")
    if ply:
        count = points.write_ply(ply, title, seen.cloud)
        voice.line(f"points: {ply}, {count} in the camera frame, m")
        written["ply"] = str(ply)
    if view:
        points.view(title, seen.cloud)
    return {"shown": written}
