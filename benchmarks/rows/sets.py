"""The row of PointNet++: neighbourhoods that stage graphs has made beside those made in each step."""

from typing import Any

import numpy as np

from benchmarks.rows.at_hand import SETS, Street
from benchmarks.rows.row import Row, compare, ms
from models.steering.core import batch as batches
from models.steering.spatial.pointnet2 import PointNet2
from pipeline.graphs import neighbourhoods
from pipeline.sections.graphs import Variant

FRAMES = 4


def pointnet2(street: Street, device: str) -> Row:
    """Both read the points; the peer samples and groups them, ours reads that as well."""
    street.make(SETS)
    levels = Variant(source="clouds/lidar", neighbourhood="pointnet2", points=street.points).levels
    net = PointNet2(32, len(levels)).to(device)
    rng = np.random.default_rng(0)

    def step(arrays: dict[str, np.ndarray]) -> None:
        batch: Any = batches.from_arrays(arrays).to(device)
        net(batch).square().sum().backward()

    def each_time() -> None:
        arrays = street.arrays(FRAMES, SETS)
        ends, before = arrays["ptr"][1:-1], np.zeros(FRAMES, np.int64)
        made = [neighbourhoods.levels(xyz, levels, rng) for xyz in np.split(arrays["xyz"], ends)]
        before = arrays["ptr"][:-1]  # rows of the frames before
        for number, of_frames in enumerate(zip(*made, strict=True), start=1):
            pairs = list(zip(of_frames, before, strict=True))
            arrays[f"centres_{number}"] = np.concatenate([level.centres + first for level, first in pairs])
            arrays[f"neighbours_{number}"] = np.concatenate([level.neighbours + first for level, first in pairs])
            ptr = np.cumsum([0, *(len(level.centres) for level in of_frames)])
            arrays[f"centres_{number}_ptr"], before = ptr, ptr[:-1]
        step(arrays)

    return compare(
        ms(lambda: step(street.arrays(FRAMES, SETS)), FRAMES),
        ms(each_time, FRAMES),
        "ms a frame",
        f"{street.points:,} points: PointNet++ on cached neighbourhoods / made in each step, forward + backward",
    )
