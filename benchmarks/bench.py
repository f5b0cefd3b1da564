"""``make bench``: each figure of docs/scale.md beside what a user would pick instead, as a table and results.json.

Ours and a peer run in one process, in turn, on the same arrays, five times; medians count. Clouds are recorded scans
where a folder of KITTI raw is at hand, and the sample's.
"""

import contextlib
import json
import os
import platform
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated

import torch
import typer

from benchmarks.rows import at_hand, building, chain, files, graph_network, recurrent, sets, steps
from benchmarks.rows.at_hand import Street
from benchmarks.rows.row import Row
from pipeline.base import console
from pipeline.base.atomic import replacing
from pipeline.base.errors import InputError, closest
from pipeline.report.tables import markdown_table

CODE = Path(__file__).resolve().parents[1]
SAMPLE_POINTS = 1000
BY_NAME = ("cluster", "demo")  # minutes each: measured where they are named


@dataclass(frozen=True)
class Given:
    """What there is to measure on. Graphs are made when the first row asks for them."""

    kitti: Path | None
    data: Path
    scratch: Path

    @cached_property
    def street(self) -> Street:
        """Recorded scans at the paper's size; the sample's whole clouds where there are none."""
        if self.kitti:
            return at_hand.recorded(self.kitti, self._folder())
        return at_hand.sample(self.made, self._folder(), 43_000)

    @cached_property
    def sample(self) -> Street:
        """The sample at its own size."""
        return at_hand.sample(self.made, self._folder(), SAMPLE_POINTS)

    def _folder(self) -> Path:
        return Path(tempfile.mkdtemp(dir=self.scratch))  # of its own: what failed half-way is in nobody's way

    @property
    def made(self) -> Path:
        """What ``make demo`` made."""
        if not (self.data / "graphs/semantic/index.json").is_file():
            raise InputError(f"{self.data} has no sample: run make demo first, or name its folder with --data")
        return self.data


def rows() -> dict[str, Callable[[Given], Row]]:
    """Return what measures each row. Networks run on the CPU and, as NAME_cuda, on a GPU if there is one."""
    of_graph = {
        "gcn_vs_pyg_edge_index": graph_network.vs_pyg_edge_index,
        "gcn_vs_pyg_csr": graph_network.vs_pyg_csr,
        "gcn_vs_linear": graph_network.vs_linear,
        "equivariant_vs_plain": steps.equivariant_vs_plain,
        "windows_vs_naive": steps.windows_vs_naive,
        "step_ms": steps.step_ms,
        "peak_memory_gb": steps.peak_memory_gb,
        "load": files.load,
        "pointnet2": sets.pointnet2,
    }
    of_cell = {"ltc": recurrent.vs_ncps, "ltc_vs_lstm": recurrent.vs_lstm}
    of_files = {
        "graph_build": building.graph_build,
        "knn_vs_scipy": building.knn_vs_scipy,
        "knn_vs_open3d": building.knn_vs_open3d,
        "knn_vs_pykdtree": building.knn_vs_pykdtree,
        "graphs_stage_fps": building.graphs_stage_fps,
        "bytes": files.size,
    }
    every: dict[str, Callable[[Given], Row]] = {}
    for name, of_street in of_graph.items():
        every[name] = partial(lambda row, given: row(given.street, "cpu"), of_street)
    for name, of_clouds in of_files.items():
        every[name] = partial(lambda row, given: row(given.street), of_clouds)
    for name, of_windows in of_cell.items():
        every[name] = partial(lambda row, given: row("cpu"), of_windows)
    every |= {
        "sample_gcn_vs_pyg_edge_index": lambda given: graph_network.vs_pyg_edge_index(given.sample, "cpu"),
        "sample_gcn_vs_pyg_csr": lambda given: graph_network.vs_pyg_csr(given.sample, "cpu"),
        "sample_equivariant_vs_plain": lambda given: steps.equivariant_vs_plain(given.sample, "cpu"),
        "sample_graph_build": lambda given: building.graph_build(given.sample),
        "sample_graphs_stage_fps": lambda given: building.graphs_stage_fps(given.sample),
        "sample_bytes": lambda given: files.size(given.sample),
        "sample_load": lambda given: files.load(given.sample, "cpu"),
        "table2_side_by_side": lambda given: chain.side_by_side(given.made),
        "blocks": lambda given: chain.blocks(given.made),
        "cluster": lambda given: chain.cluster(given.made),
        "demo": lambda given: chain.demo(CODE),
    }
    if torch.cuda.is_available():
        for name, of_street in of_graph.items():
            every[f"{name}_cuda"] = partial(lambda row, given: row(given.street, "cuda"), of_street)
        for name, of_windows in of_cell.items():
            every[f"{name}_cuda"] = partial(lambda row, given: row("cuda"), of_windows)
    return every


def main(
    names: Annotated[list[str] | None, typer.Argument(metavar="ROW", help="default: all that take seconds")] = None,
    kitti: Annotated[
        Path | None, typer.Option(envvar="STEER_KITTI", help="a folder of KITTI raw with scans; without, the sample's")
    ] = None,
    data: Annotated[Path, typer.Option(help="what make demo made")] = Path("data"),
    out: Annotated[
        Path | None, typer.Option(help="where the figures go, beside those that are there; without, they are printed")
    ] = None,
) -> None:
    """Measure rows and print them as a Markdown table. Status 1 if a row failed.

    The table says why; a peer that is not installed is named there, too, and is no failure.
    """
    every = rows()
    for name in names or []:
        if name not in every:
            raise InputError(f"there is no row {name!r}: {closest(name, list(every))}")
    if kitti and not kitti.is_dir():
        raise InputError(f"{kitti} is no folder: name one of KITTI raw with --kitti or STEER_KITTI, or neither")
    with tempfile.TemporaryDirectory() as scratch:
        given = Given(kitti, data, Path(scratch))
        chosen = names or [name for name in every if name not in BY_NAME]
        measured = {name: _measured(name, every[name], given) for name in chosen}
    print(table(measured))
    print(f"\n{device()}")
    if out:
        content = results(measured)
        before = json.loads(out.read_text(encoding="utf-8")) if names and out.is_file() else {}
        if before.get("device") == content["device"]:  # figures of another machine are no neighbours
            content["rows"] = before["rows"] | content["rows"]
        with replacing(out) as tmp:
            tmp.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if any(isinstance(row, str) and not row.startswith(ModuleNotFoundError.__name__) for row in measured.values()):
        raise typer.Exit(1)


def _measured(name: str, measure: Callable[[Given], Row], given: Given) -> Row | str:
    start = time.perf_counter()
    try:
        with contextlib.redirect_stdout(sys.stderr):
            row: Row | str = measure(given)
    except Exception as error:  # a peer that is missing or fails must not take the other rows with it
        traceback.print_exc()
        row = f"{type(error).__name__}: {error}".splitlines()[0]
    print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    return row


def results(measured: Mapping[str, Row | str]) -> dict:
    """Return what results.json holds: each row's figures, or why there are none."""
    of_rows = {name: {"error": row} if isinstance(row, str) else asdict(row) for name, row in measured.items()}
    return {"device": device(), "rows": of_rows}


def table(measured: Mapping[str, Row | str]) -> str:
    """Return the rows as Markdown."""
    body = []
    for name, row in measured.items():
        if isinstance(row, str):
            body.append([name, "", "", "", "", f"not measured: {row}"])
        else:
            peer, ratio = ("" if figure is None else f"{figure:.3g}" for figure in (row.peer, row.ratio))
            body.append([name, f"{row.ours:.3g}", peer, row.unit, ratio, row.what])
    return markdown_table(["row", "ours", "peer", "unit", "ratio", "ours / peer"], body)


def device() -> str:
    """Name the processor, its cores and threads, and the GPU if there is one."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").is_file() else ""
    models = [line.partition(":")[2].strip() for line in info.splitlines() if line.startswith("model name")]
    cores = len(os.sched_getaffinity(0))
    cpu = f"{models[0] if models else platform.machine()}, {cores} cores, {torch.get_num_threads()} threads"
    return f"{torch.cuda.get_device_name()}; {cpu}" if torch.cuda.is_available() else cpu


if __name__ == "__main__":
    console.run(main)
