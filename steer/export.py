"""steer export: write a trained model as torch.export programs."""

from pathlib import Path
from typing import Annotated

import typer

from steer.options import Debug, Json, Output, Quiet


def export(
    model: Annotated[Path, typer.Argument(help="folder of a trained model, for instance data/train/sa-gnn-ncp")],
    out: Annotated[Path, typer.Option(help="folder for the files; new, empty or an earlier export")],
    graphs: Annotated[Path, typer.Option(help="folder of the graph variants, for verification")] = Path("data/graphs"),
    tolerance: Annotated[float, typer.Option(min=0, help="largest difference of features and outputs")] = 1e-4,
    quiet: Quiet = False,
    as_json: Json = False,
    debug: Debug = False,
) -> None:
    """Write a model's spatial and recurrent part as .pt2 files (torch.export), verified on real frames.

    export.json describes their inputs and how to compute the angle. Numbers of points and neighbours may differ between
    frames; each call takes one frame. For ONNX, convert each file with the package onnxscript:
    torch.onnx.export(torch.export.load("spatial.pt2"), dynamo=True).save("spatial.onnx")

    steer export data/train/sa-gnn-ncp --out net/
    """
    from pipeline.live.export import export as write
    from pipeline.train.predict import load

    output = Output(quiet, as_json)
    trained = load(model, "cpu")
    manifest = write(trained, graphs / trained.line["input"], out, tolerance)
    for part, difference in manifest["largest_difference"].items():
        output.line(
            f"{out / part}.pt2: largest difference from the network {difference:.2g} (tolerance {tolerance:.2g})"
        )
    verified = manifest["verified"]
    output.line(f"verified on {verified['windows']} windows of {', '.join(verified['drives'])}")
    output.result({"out": str(out), **manifest})
