"""Stage ingest: read each drive once, and write its data for all later stages to one HDF5 file."""

from functools import partial
from pathlib import Path

from pipeline.jobs import console
from pipeline.jobs.outputs import stage_folder
from pipeline.jobs.runner import Job, make_drives

from pipeline.base.checkout import in_checkout
from pipeline.base.errors import error_context
from pipeline.base.hashes import digest
from pipeline.base.params import load_section
from pipeline.base.summary import DOUBT
from pipeline.ingest import drive as datasets
from pipeline.ingest import validate
from pipeline.ingest.datasets import kitti
from pipeline.ingest.settings import Ingest, Reading
from pipeline.ingest.write import ingest_drive


def main(
    data: Path = Path("data"), raw: Path = Path("data/raw"), params: Path = Path("params.yaml")
) -> Path:
    """Read images, scans, calibration, logs and ground truth of all drives. Return the folder."""
    raw = in_checkout(raw)
    settings = load_section(Ingest, params)
    out = data / "ingest"

    splits = settings.drives.splits()
    # The names of all missing drives are one message.
    if settings.source == "kitti":
        kitti.check_drives(raw, splits)

    # Of the code of all datasets, a drive depends only on that of its own.
    reader = f"pipeline/ingest/datasets/{settings.source}.py"
    root = data / "sample" if settings.source == "sample" else raw
    reading = Reading(**settings.model_dump(include=set(Reading.model_fields)))
    dataset = datasets.load_dataset(settings.source)
    with stage_folder("ingest", out, splits, params=params, chosen=[reader]) as folder:
        jobs = []
        for drive in splits:
            facts = dataset.fingerprint(drive, settings, root)
            with error_context(drive):
                validate.check_fingerprint(facts)
            work = partial(
                ingest_drive,
                name=drive,
                dataset=settings.source,
                settings=settings,
                root=root,
                reading=reading,
            )
            inputs = [digest([settings.source, facts])]
            jobs.append(Job(drive, f"{drive}.h5", inputs, work))

        summaries = make_drives(folder, jobs, reading, log_format="{frames} frames{counts}")
        steps_s = {drive: summary["step_s"] for drive, summary in summaries.items()}
        doubts = []
        for drive, summary in summaries.items():
            doubts += [f"{DOUBT}{drive}: {doubt}" for doubt in summary["doubts"]]
        rate_doubt = validate.rate_doubt(steps_s, settings.drives.train)
        if rate_doubt:
            doubts.append(rate_doubt)
        for doubt in doubts:
            print(doubt, flush=True)
    return out


if __name__ == "__main__":
    console.run(main)
