"""Stage perception: predict depth and classes of every image with the unified encoder, data/perception/<drive>.h5."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.executors import default_workers
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.runner import Job, make_drives
from pipeline.settings.perception import Perception


def main(
    ingest: Path = Path("data/ingest"),
    encoder: Path = Path("data/encoder"),
    out: Path = Path("data/perception"),
    params: Path = Path("params.yaml"),
    workers: int | None = None,
) -> Path:
    """Predict depth and classes of each image, scale the depth, and store both. Returns the output folder."""
    import torch

    from pipeline.perception.drive import cached_encoder, perceive_drive
    from pipeline.perception.perceive import weights_file

    settings = load(Perception, params)
    splits = store.read_index(ingest, stage="ingest")
    cached_encoder(encoder, settings.precision)  # report a bad checkpoint once, not from each worker
    jobs = [
        Job(
            drive,
            f"{drive}.h5",
            [ingest / f"{drive}.h5", weights_file(encoder)],
            partial(perceive_drive, ingest=ingest / f"{drive}.h5", encoder=encoder, settings=settings),
        )
        for drive in splits
    ]
    if torch.cuda.is_available():  # two processes keep a GPU busy: one reads and writes while the other encodes
        workers = min(2, workers or default_workers())
    with stage_folder("perception", out) as folder:
        summaries = make_drives(folder, jobs, settings, "{frames} frames".format_map, workers)
        store.write_index(folder.new, splits)
    without = [drive for drive, summary in summaries.items() if not summary["frames"]]
    if without:
        print(f"no images in {', '.join(without)}, so no depth and classes", flush=True)
    return out


if __name__ == "__main__":
    console.run(main)
