"""How clouds and graphs may lie on disk: bytes and reading time of a frame, by encoding. See docs/files.md."""

import statistics
import tempfile
import time
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import h5py
import hdf5plugin
import numpy as np
import typer

from pipeline.base import console, store

CHUNK_ROWS = 32768  # as pipeline/base/store.py
ROUNDS = 7  # medians of so many
SHUFFLE, BITSHUFFLE = hdf5plugin.Blosc2.SHUFFLE, hdf5plugin.Blosc2.BITSHUFFLE
FILTERS: dict[str, Mapping[str, Any]] = {
    "none": {},
    "gzip 1, shuffle": {"compression": "gzip", "compression_opts": 1, "shuffle": True},
    "lzf, shuffle": {"compression": "lzf", "shuffle": True},
    "Bitshuffle lz4": hdf5plugin.Bitshuffle(cname="lz4"),
    "Blosc2 lz4, shuffle": hdf5plugin.Blosc2(cname="lz4", filters=SHUFFLE),
    "Blosc2 zstd 1, shuffle": hdf5plugin.Blosc2(cname="zstd", clevel=1, filters=SHUFFLE),
    "Blosc2 lz4, bitshuffle": hdf5plugin.Blosc2(cname="lz4", filters=BITSHUFFLE),
    "the same, checksum": {**hdf5plugin.Blosc2(cname="lz4", filters=BITSHUFFLE), "fletcher32": True},
}


def main(
    graphs: Annotated[Path, typer.Argument(help="a graph file of a kNN variant")],
    frames: Annotated[int, typer.Option(min=1, help="of its first so many")] = 6,
) -> None:
    """Print a Markdown table: kB a frame, and ms of one core to read one alone, from what the system has in memory."""
    with store.DriveReader(graphs, stage="graphs") as file:
        ptr, indices_ptr = file["ptr"][: frames + 1], file["indices_ptr"][: frames + 1]
        of_points = {name: file.rows(name, 0, ptr[-1]) for name in ("xyz", "degree", "cls")}
        indices = file.rows("indices", 0, indices_ptr[-1])
    columns = {name: (rows, ptr) for name, rows in encodings(of_points["xyz"]).items()}
    columns |= {name: (rows, indices_ptr) for name, rows in differences(indices, of_points["degree"]).items()}
    columns |= {name: (of_points[name], ptr) for name in ("degree", "cls")}
    print(f"| filter | {' | '.join(columns)} |\n|---|{'--:|' * len(columns)}")
    with tempfile.TemporaryDirectory() as folder:
        for name, options in FILTERS.items():
            cells = [measured(Path(folder) / "a.h5", rows, ptr, options) for rows, ptr in columns.values()]
            print(f"| {name} | {' | '.join(f'{kilobytes:.0f}, {ms:.2f}' for kilobytes, ms in cells)} |")


def encodings(xyz: np.ndarray) -> dict[str, np.ndarray]:
    """Return points [N,3] in steps of 1/1024 m in the ways that they could be stored."""
    steps = np.rint(xyz * 1024).astype(np.int32)
    return {
        "xyz float32": xyz,
        "int32 steps": steps,
        "int32 differences": np.diff(steps, axis=0, prepend=np.int32(0)),
        "int16 of 4 mm": np.rint(xyz * 256).astype(np.int16),
    }


def differences(indices: np.ndarray, degree: np.ndarray) -> dict[str, np.ndarray]:
    """Return neighbours [E] of all nodes as they are, less the one before, and less the node itself (modulo 2^16)."""
    node = np.repeat(np.arange(len(degree)), degree)
    return {
        "indices uint16": indices,
        "less the last": np.diff(indices, prepend=indices.dtype.type(0)),
        "less the node": (indices - node).astype(indices.dtype),
    }


def measured(path: Path, rows: np.ndarray, ptr: np.ndarray, options: Mapping[str, Any]) -> tuple[float, float]:
    """Write the rows of all frames; return kB of a frame, and ms of CPU to read one, the median over all."""
    with h5py.File(path, "w", libver="v110") as file:
        chunks = (CHUNK_ROWS, *rows.shape[1:])
        kilobytes = file.create_dataset("rows", data=rows, chunks=chunks, **options).id.get_storage_size() / 1000
    out, times = np.zeros_like(rows), []
    with h5py.File(path, rdcc_nbytes=0) as file:  # no chunk is remembered
        dataset = file["rows"]
        for frame in [*pairwise(ptr.tolist())] * ROUNDS:
            start = time.process_time()
            dataset.read_direct(out, np.s_[slice(*frame)], np.s_[slice(*frame)])
            times.append(time.process_time() - start)
    return kilobytes / (len(ptr) - 1), 1000 * statistics.median(times)


if __name__ == "__main__":
    console.run(main)
