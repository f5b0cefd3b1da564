"""Stage perception: depth and classes of every image, data/perception/<drive>.h5."""

from functools import partial
from pathlib import Path

import torch

from pipeline.jobs import console
from pipeline.jobs.executors import default_workers
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import file_jobs, make_drives

from pipeline.base import store
from pipeline.base.hashes import file_hash
from pipeline.base.params import load_section
from pipeline.encoder.encoder_file import FILE
from pipeline.perception.perceive import find_warnings, perceive_drive
from pipeline.perception.settings import Perception


def main(data: Path = Path("data"), params: Path = Path("params.yaml")) -> Path:
    """Predict depth and classes of each image with the encoder. Return the output folder."""
    settings = load_section(Perception, params)
    ingest = data / "ingest"
    encoder = data / "encoder"
    out = data / "perception"
    splits = store.read_index(ingest, stage="ingest")
    with stage_folder("perception", out, splits, params=params) as folder:
        # This also reports a bad checkpoint, once instead of from each worker.
        files = [ingest / f"{drive}.h5" for drive in splits]
        for line in find_warnings(encoder, settings.precision, files):
            print(line, flush=True)

        # Two processes keep a GPU busy: one reads and writes while the other encodes.
        workers = None
        if torch.cuda.is_available():
            workers = min(2, default_workers())
        # A user may set STEER_WORKERS to limit the memory that is used.
        passes = default_workers()
        work = partial(perceive_drive, encoder=encoder, settings=settings, max_passes=passes)
        jobs = file_jobs(splits, {"ingest": ingest}, work)
        key = settings.model_dump() | {"encoder": file_hash(encoder / FILE)}
        make_drives(folder, jobs, key, log_format="{frames} frames{facts}", workers=workers)
    return out


if __name__ == "__main__":
    console.run(main)
