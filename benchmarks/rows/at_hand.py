"""What the rows measure on: graphs of recorded scans at the paper's size, and of the sample at its own."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from pipeline.base import store
from pipeline.base.errors import InputError
from pipeline.graphs import cloud
from pipeline.kitti.raw import find_drives
from pipeline.motion import kinds
from pipeline.sections.preset import merged
from pipeline.train import frames
from stages import graphs, ingest, labels

FRAMES = 31  # a run of 24 windows of 8
SETS = "sets"  # the variant with PointNet++'s neighbourhoods


@dataclass(frozen=True)
class Street:
    """A drive of FRAMES frames in `folder`: clouds, labels, graphs/semantic and, if asked for, graphs/sets."""

    folder: Path
    drive: str
    source: str  # of the clouds, as in section graphs
    points: int

    @property
    def params(self) -> Path:
        """The params file that made it."""
        return self.folder / "params.yaml"

    @property
    def file(self) -> Path:
        """The graph file."""
        return self.folder / f"graphs/semantic/{self.drive}.h5"

    @property
    def settings(self) -> dict:
        """The entry `semantic` of section graphs."""
        settings: dict = yaml.safe_load(self.params.read_text(encoding="utf-8"))["graphs"]["semantic"]
        return settings

    def arrays(self, count: int, variant: str = "semantic") -> frames.Arrays:
        """Return the first `count` frames as networks are given them."""
        with frames.open_graphs(self.folder / f"graphs/{variant}/{self.drive}.h5") as file:
            return file.read(0, count)

    def make(self, variant: str) -> None:
        """Run stage graphs, in this process."""
        graphs.main(variant, self.folder, self.folder / "graphs", self.params, workers=1)


def recorded(kitti: Path, folder: Path, points: int = 43_000) -> Street:
    """Bring the scans of a recorded drive to `points` points, by the project's own stages.

    A scan has no classes; pruning wants some. Here what lies low is road, and what stands on it is of one class per
    column of 4 m: neighbours mostly agree, as in a street.

    Args:
        kitti: holds 2011_09_26/2011_09_26_drive_0052_sync/…; the shortest drive that is long enough is taken.
    Raises: InputError if there is none.
    """
    lengths = {path.name: len(list(path.glob("velodyne_points/data/*.bin"))) for path in kitti.glob("*/*_sync")}
    long_enough = sorted((count, name) for name, count in lengths.items() if count >= FRAMES)
    if not long_enough:
        raise InputError(f"{kitti} has no drive of {FRAMES} scans: name another folder of KITTI raw with --kitti")
    drive = long_enough[0][1].removesuffix("_sync")
    other = next(name.removesuffix("_sync") for name in sorted(lengths) if name != f"{drive}_sync")
    params = _params(folder, "clouds/lidar", points)
    content = yaml.safe_load(params.read_text(encoding="utf-8"))
    content["ingest"] |= {"source": "kitti", "drives": {"train": [drive], "test": [other]}, "image_size": [96, 320]}
    params.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    find_drives(kitti, [drive, other])
    ingest.main(folder / "town", kitti, folder / "ingest", params, workers=1)
    labels.main(folder / "ingest", folder / "labels", params)
    out = folder / f"clouds/lidar/{drive}.h5"
    with (
        store.DriveReader(folder / f"ingest/{drive}.h5", stage="ingest") as raw,
        store.DriveWriter(out, stage="clouds", drive=drive, params={}) as file,
    ):
        rows = np.flatnonzero(raw["has_lidar"])[:FRAMES]
        cloud.write(file, raw.frame[rows], raw.time_s[rows], _lifted(raw, rows, content["clouds"]["max_points"]))
    return _with_graphs(Street(folder, drive, "clouds/lidar", points))


def sample(data: Path, folder: Path, points: int) -> Street:
    """Bring clouds of the sample, which ``make demo`` left in `data`, to `points` points or as many as there are."""
    splits = store.read_index(data / "clouds/pseudo", stage="clouds")
    drive = next(iter(splits))
    _params(folder, "clouds/pseudo", points)
    with (
        store.DriveReader(data / f"clouds/pseudo/{drive}.h5", stage="clouds") as source,
        store.DriveWriter(folder / f"clouds/pseudo/{drive}.h5", stage="clouds", drive=drive, params={}) as file,
    ):
        ptr = source["ptr"][: FRAMES + 1]
        clouds = [(source.rows("xyz", *ends), source.rows("cls", *ends)) for ends in pairwise(ptr)]
        cloud.write(file, source.frame[:FRAMES], source.time_s[:FRAMES], clouds)
    (folder / "labels").symlink_to((data / "labels").resolve())
    return _with_graphs(Street(folder, drive, "clouds/pseudo", points))


def _params(folder: Path, source: str, points: int) -> Path:
    content = merged("kitti")
    content["models"] = {}
    content["clouds"]["max_points"] = max(points, content["clouds"]["max_points"])
    content["graphs"] = {
        "semantic": {"source": source, "points": points, "k": 6, "keep_inter_class": 0.2},
        SETS: {"source": source, "neighbourhood": "pointnet2", "points": points},
    }
    (folder / "params.yaml").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return folder / "params.yaml"


def _with_graphs(street: Street) -> Street:
    store.write_index(street.folder / street.source, {street.drive: "train"})
    kinds.write(street.folder / "motion", [])
    street.make("semantic")
    return street


def _lifted(raw: store.DriveReader, rows: np.ndarray, max_points: int) -> Iterator[cloud.Cloud]:
    ptr = raw["lidar_ptr"]
    for row in rows:
        scan = raw.rows("lidar", ptr[row], ptr[row + 1])
        xyz, _ = cloud.lidar_cloud(scan, raw["T_cam_velo"], raw["K"], None)
        rng = cloud.frame_rng(0, raw.drive, int(raw.frame[row]))
        yield cloud.downsample((xyz, classes_of(xyz)), max_points, rng)


def classes_of(xyz: np.ndarray) -> np.ndarray:
    """Return trainIds uint8 [P] of points [P,3] of the camera frame: see `recorded`."""
    road, standing = 0, np.array([2, 8, 13, 5], np.uint8)  # building, vegetation, car, pole
    column = np.floor(xyz[:, [0, 2]] / 4).astype(np.int64) @ np.array([7, 13])
    return np.where(xyz[:, 1] > 1.4, road, standing[column % 4]).astype(np.uint8)
