"""Measure `make demo` without set-up: the complete chain on the embedded sample, and the time of each stage."""

import os
import shutil
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from benchmarks.row import Row

CODE = Path(__file__).resolve().parents[1]


def demo() -> Row:
    """Run ``dvc repro`` once in a copy of the code, with an empty cache."""
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
            seconds = stage_seconds(process.stdout)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, process.args)
    return demo_row(seconds)


def demo_row(seconds: Mapping[str, float]) -> Row:
    """Return the row of the total and of each stage."""
    stages = ", ".join(f"{stage} {duration:.0f}" for stage, duration in seconds.items())
    return Row(sum(seconds.values()), None, "s", None, f"make demo after set-up, once: {stages}")


def stage_seconds(lines: Iterable[str]) -> dict[str, float]:
    """Return stage → seconds from the output of ``dvc repro`` as it comes; graphs@a and graphs@b count as graphs."""
    seconds: defaultdict[str, float] = defaultdict(float)
    stage, start = "", time.perf_counter()
    for line in lines:
        if line.startswith("Running stage"):
            now = time.perf_counter()
            if stage:
                seconds[stage] += now - start
            stage, start = line.split("'")[1].partition("@")[0], now
    if stage:
        seconds[stage] += time.perf_counter() - start
    return dict(seconds)
