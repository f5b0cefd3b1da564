"""The command steer as a shell sees it: quick help, one line for an error, its trace if asked for."""

import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.resume import ROOT

HEAVY = ("torch", "cv2", "h5py", "open3d", "matplotlib", "scipy", "plotly", "pykitti", "tqdm")


def steer(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "steer", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_help_imports_nothing_large() -> None:
    code = f"import sys, steer.app; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_names_the_verbs_and_each_has_an_example() -> None:
    done = steer("--help")
    assert done.returncode == 0
    verbs = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("│ ") and line[2].islower()]
    assert "predict" in verbs
    for verb in verbs:
        assert f"steer {verb} " in steer(verb, "--help").stdout.replace("Usage: steer", "")


@pytest.mark.slow
def test_an_error_is_one_line_and_a_trace_only_if_asked_for(tmp_path: Path) -> None:
    done = steer("predict", tmp_path, "--model", tmp_path / "none")
    assert done.returncode == 1
    assert done.stdout == ""
    assert (
        done.stderr
        == f"error: {tmp_path}/none is not a trained model, best.pt is missing: train it: dvc repro train@none\n"
    )
    assert "Traceback" in steer("predict", tmp_path, "--model", tmp_path / "none", "--debug").stderr
