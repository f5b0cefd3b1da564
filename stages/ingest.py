"""Read KITTI drives once and write one HDF5 file per drive, with everything that later stages need."""

from functools import partial
from pathlib import Path

from pipeline.base import console, store
from pipeline.base.errors import InputError
from pipeline.base.outputs import stage_folder
from pipeline.base.params import load
from pipeline.base.resume import file_hash
from pipeline.base.runner import Job, make_drives
from pipeline.kitti.ingest import ingest_kitti
from pipeline.kitti.raw import MANIFEST, KittiDrive, find_drives, leave_out
from pipeline.settings.ingest import Ingest, Reading


def main(
    sample: Path = Path("data/sample"),
    raw: Path = Path("data/raw"),
    out: Path = Path("data/ingest"),
    params: Path = Path("params.yaml"),
) -> Path:
    """Read oxts, steering angles, images, LiDAR scans, calibration and dense ground truth. Returns the folder."""
    settings = load(Ingest, params)
    splits, sources = settings.drives.splits(), settings.sources()
    recorded = [drive for drive in splits if sources[drive] == "kitti"]
    before = store.read_index(out, stage="ingest") if (out / "index.json").is_file() else {}
    missing = leave_out(raw, recorded, splits, required={*settings.manifests, *before})
    splits = {drive: split for drive, split in splits.items() if drive not in missing}
    drives: dict[str, KittiDrive] = {}
    for source, root in {"sample": sample, "kitti": raw}.items():
        drives |= find_drives(root, [drive for drive in splits if sources[drive] == source])
    for drive, manifest in settings.manifests.items():
        if drive in drives and file_hash(drives[drive].folder / MANIFEST) != manifest:
            fix = "Use the preset that steer import wrote: make params PRESET=NAME, then dvc repro"
            raise InputError("drive was imported again, ingest.manifests has the one before", drives[drive].folder, fix)
    jobs, reading = [], Reading(**settings.model_dump(include=set(Reading.model_fields)))
    for drive, files in sorted(drives.items(), key=lambda item: len(item[1].oxts), reverse=True):  # the longest first
        work = partial(ingest_kitti, drive=drive, folder=files.folder, settings=reading)
        jobs.append(Job(drive, f"{drive}.h5", [files.fingerprint(settings.cameras)], work))
    with stage_folder("ingest", out) as stage:
        make_drives(stage, jobs, reading, "{frames} frames{counts}")
        store.write_index(stage.new, splits)
    return out


if __name__ == "__main__":
    console.run(main)
