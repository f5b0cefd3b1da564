"""steer export: a trained model for programs without Python, as torch.export and ONNX have it."""

from pathlib import Path
from typing import Annotated

import typer

from steer.options import Debug, Json, Quiet, Voice


def export(
    model: Annotated[Path, typer.Argument(help="a trained model's folder, as data/train/sa-gnn-ncp")],
    out: Annotated[Path, typer.Option(help="gets the files; new, empty or an earlier export")],
    graphs: Annotated[Path, typer.Option(help="holds the graph variants: real frames to verify by")] = Path(
        "data/graphs"
    ),
    tolerance: Annotated[
        float, typer.Option(min=0, help="of features and answers, both about 1 in size; more is an error")
    ] = 1e-4,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a model's spatial and recurrent part as .pt2 (torch.export) and .onnx, verified on real frames.

    export.json beside them says what they take and give, and how an answer becomes an angle. Numbers of points and
    edges may change from frame to frame; frames are one at a time. ONNX takes: pip install '.[onnx]'.

    steer export data/train/sa-gnn-ncp --out out/sa-gnn-ncp
    """
    from pipeline.live.export.export import export as written
    from pipeline.train import predict

    voice = Voice(quiet, as_json)
    trained = predict.load(model, "cpu")
    content = written(trained, graphs / trained.line["input"], out, tolerance)
    for file, why in content["without"].items():
        voice.line(f"no {file}: {why}")
    verified = content["verified"]
    for file, difference in verified["largest_difference"].items():
        voice.line(f"{file}: differs from the network by {difference:.2g} at most")
    voice.line(
        f"{out}: {trained.name}, verified on {verified['windows']} windows of {', '.join(verified['drives'])}; "
        f"tolerance {tolerance:.2g}, 1 is {trained.target.std_rad:.3f} rad"
    )
    voice.result({"out": str(out), **content})
