"""Frames at a preset's sizes where there is no KITTI: the town, seen by sensors like KITTI's, through the stages.

So neighbourhoods, pruning, order in memory and compression are those of a street, not of random numbers.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from pipeline.base import store
from pipeline.motion import kinds
from pipeline.sections.preset import merged
from stages import clouds, graphs, ingest, labels, town

DRIVE, BENT = "2026_01_01_drive_0002", 39  # of so many frames some bend: labels that are all zero are refused
# Of table2; what others add to these, motion and a horizon, costs a step nothing.
MODELS = ("cnn-ncp", "gnn-lstm", "gnn-ncp", "pointnet2-lstm", "pointnet2-ncp", "do-gnn-ncp", "sa-gnn-ncp", "odd")
KITTI = {"image_size": [375, 1242], "scan_rays": [64, 2000]}


def write_params(preset: str, out: Path, frames: int, sensors: dict[str, list[int]] = KITTI) -> None:
    """Write params.yaml with a preset's sizes, MODELS and one town drive of `frames` frames to `out`.

    `preset`: a name in presets/, or a file. `sensors`: image_size and scan_rays of section ``town``.
    """
    content, models = merged(preset), merged("table2")["models"]
    # The sample's PointNet++ is narrow, the reference's is meant here.
    sizes = {name: {key: value for key, value in models[name].items() if key != "width"} for name in MODELS}
    content["models"] = sizes | content["models"]
    content["town"] |= {**sensors, "frames": {"train": frames, "val": 1, "test": 1}}
    # The other split must not be empty.
    content["ingest"] |= {"source": "town", "drives": {"train": [DRIVE], "test": ["2026_01_03_drive_0001"]}}
    out.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def make(params: Path, folder: Path, variants: Sequence[str]) -> None:
    """Write ``folder/labels`` and ``folder/graphs/<variant>`` of each of `variants`, by the project's own stages.

    In place of stage perception, the renderer's own depth and classes: no encoder is fitted for a matter of sizes.
    """
    record(params, folder)
    labels.main(folder / "ingest", folder / "labels", params)
    for drive in store.read_index(folder / "ingest", stage="ingest"):
        _perceive(folder / f"ingest/{drive}.h5", folder / f"perception/{drive}.h5", drive)
    clouds.main(folder / "ingest", folder / "perception", folder / "clouds", params)
    kinds.write(folder / "motion", [])
    for variant in variants:
        graphs.main(variant, folder, folder / "graphs", params)


def record(params: Path, folder: Path) -> None:
    """Write ``folder/town`` and ``folder/ingest`` by the stages of these names."""
    town.main(folder / "town", params)
    ingest.main(folder / "town", folder / "raw", folder / "ingest", params)


def _perceive(source: Path, out: Path, drive: str) -> None:
    with (
        store.DriveReader(source, stage="ingest") as raw,
        store.DriveWriter(out, stage="perception", drive=drive, params={}) as file,
    ):
        file.put("frame", raw.frame)
        file.put("time_s", raw.time_s, unit="s")
        file.put("depth_m", raw["depth"].astype(np.uint16), unit="1/256 m, 0 = none")
        file.put("cls", raw["cls"], unit="Cityscapes trainId")
