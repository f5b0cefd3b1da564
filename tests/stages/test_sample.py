"""Stage sample on drives of a few frames."""

from pathlib import Path

import yaml

from pipeline.jobs import keys

from pipeline.ingest.datasets.kitti import find_drive
from stages import sample

# two dates, two cameras
DRIVES = ["2026_01_01_drive_0001", "2026_01_01_drive_0002", "2026_01_05_drive_0001"]


def write_params(path: Path, lidar: bool = False, epochs: int = 0, **frames: int) -> Path:
    params = yaml.safe_load((keys.ROOT / "params.yaml").read_text(encoding="utf-8"))
    params["sample"] |= {"image_size": [48, 160], "scan_rays": [16, 40], "frames": frames}
    params["encoder"]["epochs"] = epochs
    params["ingest"] |= {"lidar": lidar, "drives": {"train": DRIVES[:2], "test": DRIVES[2:]}}
    path.write_text(yaml.safe_dump(params), encoding="utf-8")
    return path


def test_drives_of_the_params(tmp_path):
    """Scans and truth of training drives are rendered only where used."""
    params = tmp_path / "params.yaml"
    out = tmp_path / "sample"
    for lidar, epochs in ((False, 0), (True, 1)):
        write_params(params, lidar, epochs, train=2, val=1, test=3)
        sample.main(out, params)
        folders = sorted(path.name for path in out.glob("*/*_sync"))
        assert folders == [f"{drive}_sync" for drive in DRIVES]
        raw = [find_drive(out, drive) for drive in DRIVES]
        assert [len(drive.find_images(2)) for drive in raw] == [2, 2, 3]
        assert [len(drive.scans) for drive in raw] == ([2, 2, 3] if lidar else [0, 0, 0])
        truth = [2, 2, 3] if epochs else [0, 0, 3]
        assert [len(drive.truth_depth) for drive in raw] == truth
        assert [len(drive.truth_cls) for drive in raw] == truth
    focal = [drive.read_camera(2).K[0, 0] for drive in raw]
    assert focal[0] == focal[1] < focal[2]
