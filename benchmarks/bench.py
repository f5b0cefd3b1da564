"""Measure this project beside its alternatives, as a Markdown table and results.json (``make bench``).

Both sides of a row run in one process, in turn, on the same arrays, five times; medians count. The graphs are those of
recorded scans if a folder of KITTI raw is given, and of the embedded sample otherwise.
"""

import contextlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import torch
import typer

from benchmarks import graphs, networks
from benchmarks.street import Row, Street, recorded, sample
from pipeline.base import console, store
from pipeline.base.errors import InputError, closest

CODE = Path(__file__).resolve().parents[1]
STREET_ROWS: dict[str, Callable[[Street], Row]] = {
    "gcn_vs_pyg_edge_index": networks.beside_edge_index,
    "gcn_vs_pyg_csr": networks.beside_csr,
    "windows_vs_naive": networks.training,
    "load": graphs.load,
    "bytes": graphs.size,
    "graph_build": graphs.graph_build,
    "knn_vs_scipy": partial(graphs.neighbours, name="scipy cKDTree", search=graphs.scipy_neighbours),
    "knn_vs_open3d": partial(graphs.neighbours, name="Open3D", search=graphs.open3d_neighbours),
}


def demo() -> Row:
    """Measure `make demo` without set-up: ``dvc repro`` once, in a copy of the code with an empty cache."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("pipeline", "models", "stages"):
            shutil.copytree(CODE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("dvc.yaml", "params.yaml", ".dvcignore", "data/.gitignore"):
            (folder / name).parent.mkdir(exist_ok=True)
            shutil.copy(CODE / name, folder / name)
        environment = os.environ | {"PYTHONPATH": str(folder)}
        subprocess.run(["dvc", "init", "--quiet", "--no-scm"], cwd=folder, check=True)
        with subprocess.Popen(
            ["dvc", "repro"], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, encoding="utf-8"
        ) as process:
            assert process.stdout
            seconds = _stage_seconds(process.stdout)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, process.args)
    stages = ", ".join(f"{stage} {duration:.0f}" for stage, duration in seconds.items())
    return Row(sum(seconds.values()), None, "s", None, f"make demo after set-up, once: {stages}")


def _stage_seconds(lines: Iterable[str]) -> dict[str, float]:
    """Return stage → seconds from the output of ``dvc repro`` as it comes; graphs@a and graphs@b count as graphs."""
    running = (line.split("'")[1].partition("@")[0] for line in lines if line.startswith("Running stage"))
    starts = [(stage, time.perf_counter()) for stage in running]
    seconds: defaultdict[str, float] = defaultdict(float)
    for (stage, start), (_, end) in pairwise([*starts, ("", time.perf_counter())]):
        seconds[stage] += end - start
    return dict(seconds)


OTHER_ROWS: dict[str, Callable[[], Row]] = {"ltc": networks.ltc, "demo": demo}
BY_NAME = ("demo",)  # takes minutes, so it is not measured by default


def main(
    names: Annotated[list[str] | None, typer.Argument(metavar="ROW", help="default: all except demo")] = None,
    kitti: Annotated[
        Path | None, typer.Option(envvar="STEER_KITTI", help="KITTI raw with scans; default: measure on the sample")
    ] = None,
    data: Annotated[Path, typer.Option(help="the output of make demo")] = Path("data"),
    out: Annotated[Path | None, typer.Option(help="results as JSON")] = None,
) -> None:
    """Measure rows and print them as a Markdown table.

    The table names the error of a failed row, and the status is 1, except where an alternative is not installed.
    """
    known = [*STREET_ROWS, *OTHER_ROWS]
    for name in names or []:
        if name not in known:
            raise InputError(f"unknown row {name!r}: {closest(name, known)}")
    if kitti and not kitti.is_dir():
        raise InputError("no such folder", kitti, "Name KITTI raw with --kitti or STEER_KITTI, or leave it out")
    with tempfile.TemporaryDirectory() as scratch:

        @cache
        def make_street() -> Street:
            # A new folder for each try, in case an earlier one failed half-way.
            return recorded(kitti, Path(tempfile.mkdtemp(dir=scratch))) if kitti else sample(data)

        measured = {name: _measure(name, make_street) for name in names or [row for row in known if row not in BY_NAME]}
    print(f"{table(measured)}\n\n{device_name()}")
    if out:
        rows = {name: {"error": row} if isinstance(row, str) else asdict(row) for name, row in measured.items()}
        store.write_json(out, {"device": device_name(), "rows": rows}, sort_keys=False)
    if any(isinstance(row, str) and not row.startswith(ModuleNotFoundError.__name__) for row in measured.values()):
        raise typer.Exit(1)


def _measure(name: str, make_street: Callable[[], Street]) -> Row | str:
    """Return the row, or its error, so that the other rows are measured."""
    start = time.perf_counter()
    try:
        with contextlib.redirect_stdout(sys.stderr):
            row: Row | str = STREET_ROWS[name](make_street()) if name in STREET_ROWS else OTHER_ROWS[name]()
    except Exception as error:
        traceback.print_exc()
        row = f"{type(error).__name__}: {error}".splitlines()[0]
    print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    return row


def table(measured: Mapping[str, Row | str]) -> str:
    """Return the rows as Markdown."""
    lines = ["| row | ours | alternative | unit | ratio | ours / alternative |", "|---|--:|--:|---|--:|---|"]
    for name, row in measured.items():
        cells = [name, "", "", "", "", f"not measured: {row}"]
        if isinstance(row, Row):
            numbers = [f"{number:.3g}" if number is not None else "" for number in (row.alternative, row.ratio)]
            cells = [name, f"{row.ours:.3g}", numbers[0], row.unit, numbers[1], row.what]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def device_name() -> str:
    """Return the processor, its cores and threads, and the GPU if there is one."""
    info = Path("/proc/cpuinfo").read_text(encoding="utf-8") if Path("/proc/cpuinfo").is_file() else ""
    models = [line.partition(":")[2].strip() for line in info.splitlines() if line.startswith("model name")]
    cores = len(os.sched_getaffinity(0))
    cpu = f"{models[0] if models else platform.machine()}, {cores} cores, {torch.get_num_threads()} threads"
    return f"{torch.cuda.get_device_name()}; {cpu}" if torch.cuda.is_available() else cpu


if __name__ == "__main__":
    console.run(main)
