"""Stage perception: predict depth and classes of every image with the unified encoder,
data/perception/<drive>.h5.
"""

from functools import partial
from pathlib import Path

import torch

from pipeline.base import console, store
from pipeline.base.executors import default_workers
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.resume import file_hash
from pipeline.base.runner import file_jobs, make_drives
from pipeline.encoder.encoder_file import FILE
from pipeline.perception.perceive import perceive_drive, warnings
from pipeline.perception.settings import Perception


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Predict depth and classes of each image, and store both. Returns the output folder."""
    settings, ingest, encoder, out = (
        load(Perception, params),
        data / "ingest",
        data / "encoder",
        data / "perception",
    )
    splits = store.read_index(ingest, stage="ingest")
    with stage_folder("perception", out, splits, params=params) as folder:
        # Reports a bad checkpoint, too: once, not from each worker.
        for line in warnings(
            encoder, settings.precision, (ingest / f"{drive}.h5" for drive in splits)
        ):
            print(line, flush=True)
        # Two processes keep a GPU busy: one reads and writes while the other encodes.
        workers = min(2, default_workers()) if torch.cuda.is_available() else None
        work = partial(perceive_drive, encoder=encoder, settings=settings)
        key = settings.model_dump() | {"encoder": file_hash(encoder / FILE)}
        make_drives(
            folder, file_jobs(splits, {"ingest": ingest}, work), key, "{frames} frames", workers
        )
    return out


if __name__ == "__main__":
    console.run(main)
