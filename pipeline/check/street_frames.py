"""Make small frames of streets in memory, on which stage check runs the networks.

A frame has the columns of a graph file, see pipeline/graphs/graph_file.py.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.sparse import csr_array

from models.steering.core.batch import SIGNS, GraphBatch, from_arrays
from models.steering.core.options import NetworkOptions
from pipeline.base.store import Column
from pipeline.camera import classes
from pipeline.clouds.cloud import Cloud
from pipeline.clouds.columns import POINTER, SOURCES
from pipeline.graphs.frame_graph import connect_points
from pipeline.graphs.graph_file import Arrays, Columns
from pipeline.graphs.settings import Variant

# Height in metres of the camera above the road.
CAMERA_M = 1.65
# Largest depth in metres of a point.
FAR_M = 60.0
# Rows and columns of the random colours that make an image.
PATCHES = (6, 12)


def make_frames(
    variant: Variant, counts: Sequence[int], image_size: tuple[int, int], seed: int
) -> list[Columns]:
    """Return frames of a variant: streets with these numbers of points, or images [H,W]."""
    rng = np.random.default_rng(seed)
    frames = []
    for count in counts:
        if variant.kind == "image":
            frames.append({"image": Column(_draw_image(image_size, rng)[None], "RGB", "ptr")})
        else:
            street = draw_street(count, rng)
            further = _draw_columns(variant, count, rng)
            frames.append(connect_points(Cloud({**street.columns, **further}), variant, rng))
    return frames


def _draw_image(size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return an image of random patches, uint8 [H,W,3]."""
    height, width = size
    patches = rng.integers(0, 256, (*PATCHES, 3), np.uint8)
    return cv2.resize(patches, (width, height), interpolation=cv2.INTER_LINEAR)


def _draw_columns(variant: Variant, points: int, rng: np.random.Generator) -> Columns:
    """Return the further columns of a variant with random values: 0 to 1, or -1 to 1 with signs."""
    columns = {}
    for name in variant.columns:
        further = SOURCES[variant.source.removeprefix("clouds/")][name]
        lowest = np.minimum(further.signs, 0)
        values = rng.uniform(lowest, 1, (points, len(further.signs)))
        if further.type == "uint8":
            values *= 255
        columns[name] = further.with_rows(values)
    return columns


def draw_street(points: int, rng: np.random.Generator) -> Cloud:
    """Return the points that a camera sees of a road between two rows of houses or trees."""
    # Directions of random pixels, x / z and y / z.
    aside = rng.uniform(-0.8, 0.8, points)
    down = rng.uniform(-0.2, 0.3, points)

    # A ray ends on the road, at one of the two rows, or far away.
    road_m = CAMERA_M / np.maximum(down, 1e-3)
    left_m, right_m = rng.uniform(3, 12, 2)
    row_m = np.where(aside < 0, left_m, right_m) / np.maximum(np.abs(aside), 1e-3)
    depth_m = np.minimum(np.minimum(road_m, row_m), FAR_M)
    xyz = np.stack([aside, down, np.ones(points)], axis=1) * depth_m[:, None]

    left, right = rng.choice([classes.BUILDING, classes.VEGETATION], 2)
    cls = np.where(road_m < row_m, classes.ROAD, np.where(aside < 0, left, right))
    return Cloud.from_arrays(xyz.astype(np.float32), cls.astype(np.uint8))


def join_frames(frames: Sequence[Columns], network: NetworkOptions) -> Arrays:
    """Return frames as one batch of new arrays for a network, as the reader of a training does."""
    batch = {}
    for name, column in frames[0].items():
        if not column.pointer:
            continue
        rows = [frame[name].rows for frame in frames]
        batch[column.pointer] = np.cumsum([0, *(len(part) for part in rows)])
        batch[name] = np.concatenate(rows)
        if column.signs:
            batch[name + SIGNS] = np.array(column.signs, np.float32)
    if "indices" in batch:
        first_rows = np.repeat(batch["ptr"][:-1], np.diff(batch["indices_ptr"]))
        batch["indices"] = batch["indices"].astype(np.int32) + first_rows.astype(np.int32)
    if "xyz" in batch:
        points = from_arrays(batch)
        assert isinstance(points, GraphBatch)
        prepared = network.prepare(points)
        if prepared is not None:
            batch["prepared"] = prepared.numpy()
    return batch


def shuffle_points(frame: Columns, rng: np.random.Generator) -> Columns:
    """Return a frame of points in another order."""
    degree = frame["degree"].rows
    indices = frame["indices"].rows
    order = rng.permutation(len(degree))
    starts = np.cumsum([0, *degree])
    links = csr_array((np.ones(len(indices)), indices, starts), shape=(len(degree), len(degree)))
    shuffled = links[order][:, order].sorted_indices()

    result = dict(frame)
    for name, column in frame.items():
        if column.pointer == POINTER:
            result[name] = column._replace(rows=column.rows[order])
    result["indices"] = frame["indices"]._replace(rows=shuffled.indices)
    return result
