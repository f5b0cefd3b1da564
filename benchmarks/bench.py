"""Measure this project beside its alternatives, as a Markdown table and results.json (``make bench``).

Both sides of a row run in one process with one thread, as stage train does, in turn, on the same arrays.
"""

import os
import platform
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import torch
import typer

from benchmarks import networks
from benchmarks.street import POINTS, Row, Street, make_street
from pipeline.base import console, store
from pipeline.base.errors import InputError, closest
from pipeline.base.outputs import check_free

STREET_ROWS: dict[str, Callable[[Street], Row]] = {
    "gcn_vs_pyg_edge_index": partial(networks.gcn, csr=False),
    "gcn_vs_pyg_csr": partial(networks.gcn, csr=True),
    "windows_vs_naive": networks.training,
    "load": networks.load,
    "bytes": networks.size,
}
ROWS = [*STREET_ROWS, "ltc"]


def main(
    names: Annotated[list[str] | None, typer.Argument(metavar="ROW", help="default: all")] = None,
    points: Annotated[int, typer.Option(help="per frame of a random street; default: the paper's")] = POINTS,
    out: Annotated[Path | None, typer.Option(help="results as JSON")] = None,
) -> None:
    """Measure rows and print them as a Markdown table."""
    for name in names or []:
        if name not in ROWS:
            raise InputError(f"unknown row {name!r}: {closest(name, ROWS)}")
    if out:
        check_free(out)
    torch.set_num_threads(1)
    names, measured = names or ROWS, {}
    with tempfile.TemporaryDirectory() as folder:
        if STREET_ROWS.keys() & names:
            street = make_street(Path(folder) / "graphs.h5", points)
        for name in names:
            measured[name] = STREET_ROWS[name](street) if name in STREET_ROWS else networks.ltc()
    print(f"{table(measured)}\n\n{device_name()}")
    if out:
        rows = {name: asdict(row) for name, row in measured.items()}
        store.write_json(out, {"device": device_name(), "rows": rows}, sort_keys=False)


def table(measured: Mapping[str, Row]) -> str:
    """Return the rows as Markdown."""
    lines = ["| row | ours | alternative | unit | ratio | ours / alternative |", "|---|--:|--:|---|--:|---|"]
    for name, row in measured.items():
        lines.append(f"| {name} | {row.ours:.3g} | {row.alternative:.3g} | {row.unit} | {row.ratio:.3g} | {row.what} |")
    return "\n".join(lines)


def device_name() -> str:
    """Return the machine, its cores, and the GPU if there is one."""
    cpu = f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, 1 thread"
    return f"{torch.cuda.get_device_name()}; {cpu}" if torch.cuda.is_available() else cpu


if __name__ == "__main__":
    console.run(main)
