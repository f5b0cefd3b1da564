"""Read the drives of all datasets once and write one HDF5 file per drive, with everything that
later stages need.
"""

from functools import partial
from pathlib import Path
from typing import Any

from pipeline.base import console, store
from pipeline.base.checkout import in_checkout
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.resume import digest
from pipeline.base.runner import Job, make_drives
from pipeline.ingest import drive as datasets
from pipeline.ingest.datasets import kitti
from pipeline.ingest.ingest_file import ingest_drive
from pipeline.ingest.settings import Ingest, Reading


def main(
    data: Path = Path("data"), raw: Path = Path("data/raw"), params: Path = Path("params.yaml")
) -> Path:
    """Read images, scans, calibration, and what was recorded or rendered beside them. Returns the
    folder.
    """
    raw = in_checkout(raw)
    settings = load(Ingest, params)
    reading = Reading(**settings.model_dump(include=set(Reading.model_fields)))
    out = data / "ingest"
    before = store.read_index(out, stage="ingest") if (out / "index.json").is_file() else {}
    missing = kitti.leave_out(raw, settings, required=before)
    splits = {
        drive: split for drive, split in settings.drives.splits().items() if drive not in missing
    }
    readers = {
        drive: f"pipeline/ingest/datasets/{dataset}.py"
        for drive, dataset in settings.datasets().items()
    }
    with stage_folder("ingest", out, splits, params=params, own=readers.values()) as stage:
        jobs = []
        facts = dict[str, list[Any]]()
        for name in splits:
            dataset = settings.datasets()[name]
            root = data / "sample" if dataset == "sample" else raw
            facts[name] = datasets.load(dataset).fingerprint(name, settings, root)
            work = partial(
                ingest_drive,
                name=name,
                dataset=dataset,
                settings=settings,
                root=root,
                reading=reading,
            )
            jobs.append(
                Job(name, f"{name}.h5", [digest([dataset, facts[name]])], work, (readers[name],))
            )
        jobs.sort(key=lambda job: len(facts[job.drive]), reverse=True)  # the longest first
        make_drives(stage, jobs, reading, "{frames} frames{counts}")
    return out


if __name__ == "__main__":
    console.run(main)
