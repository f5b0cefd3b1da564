"""Predict depth and classes of the ingested drives, and write them as PNG files.

One encoder learns from another by them (encoder.targets), and backbone: precomputed reads them. The sky has no depth.

\b
steer perceive --encoder weights/street --out data/targets
"""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer


def perceive(
    encoder: Annotated[Path, typer.Option(help="folder of an encoder")],
    out: Annotated[Path, typer.Option(help="new or empty folder for DRIVE/depth/*.png and DRIVE/cls/*.png")],
    ingest: Annotated[Path, typer.Option(help="folder of stage ingest")] = Path("data/ingest"),
) -> None:
    """Write the files; the module's docstring is the help text."""
    import numpy as np

    from pipeline.base import store
    from pipeline.base.outputs import check_free
    from pipeline.camera.camera import read_camera
    from pipeline.perception import precomputed
    from pipeline.perception.perceive import open_encoder, passes, read_batches

    check_free(out)
    predict = open_encoder(encoder, "float32").predict
    for drive in store.read_index(ingest, stage="ingest"):
        with store.DriveReader(ingest / f"{drive}.h5", stage="ingest") as source:
            rows = np.flatnonzero(source["has_image"])
            numbers = iter(source.frame[rows])
            batches = read_batches(source, read_camera(source), rows, 4)
            with closing(passes(predict, batches)) as results:
                for depths, classes in results:
                    for depth, cls in zip(depths, classes, strict=True):
                        precomputed.write(out, drive, int(next(numbers)), depth, cls)
        print(f"{drive}: {len(rows)} frames", flush=True)
