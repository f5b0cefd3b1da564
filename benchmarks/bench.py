"""Measure this project beside alternatives, in turn on the same arrays and one thread, and its
stages: make bench.
"""

import platform
import tempfile
from pathlib import Path
from typing import Annotated

import torch
import typer

from benchmarks import device, networks
from benchmarks.timing import POINTS, make_street
from pipeline.base import console
from pipeline.base.errors import InputError, closest
from pipeline.base.executors import usable_cores

ROWS = {
    "gcn_vs_pyg_edge_index": networks.gcn,
    "windows_vs_naive": networks.training,
    "ltc": networks.ltc,
}


def main(
    names: Annotated[list[str] | None, typer.Argument(metavar="ROW", help="default: all")] = None,
    points: Annotated[
        int, typer.Option(help="per frame of a random street; default: the paper's")
    ] = POINTS,
) -> None:
    """Measure rows and print them as a Markdown table."""
    for name in names or []:
        if name not in ROWS:
            raise InputError(f"unknown row {name!r}: {closest(name, [*ROWS])}")
    torch.set_num_threads(1)
    cpu = f"{platform.machine()}, {usable_cores()} cores, 1 thread"
    print(f"{torch.cuda.get_device_name()}; {cpu}" if torch.cuda.is_available() else cpu)
    print(
        "| row | ours | alternative | unit | ratio | ours / alternative |",
        "|---|--:|--:|---|--:|---|",
        sep="\n",
    )
    with tempfile.TemporaryDirectory() as folder:
        street = make_street(Path(folder), points)
        for name in names or ROWS:
            row = ROWS[name](street)
            ours, alternative = row.measure()
            # above 1: ours is better
            ratio = ours / alternative if row.unit.endswith("/s") else alternative / ours
            print(
                f"| {name} | {ours:.3g} | {alternative:.3g} | {row.unit} | {ratio:.3g} | "
                f"{row.what} |",
                flush=True,
            )
        if not names:
            print("", "| points | by the stages' own code | |", "|--:|---|--:|", sep="\n")
            for count in sorted({min(1000, points), points}):
                for text, value in device.training(Path(folder) / str(count), count):
                    print(f"| {count:,} | {text} | {value:.3g} |", flush=True)
            for text, value in device.perception():
                print(f"| | {text} | {value:.3g} |", flush=True)


if __name__ == "__main__":
    console.run(main)
