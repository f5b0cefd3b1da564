"""The command steer: quick help, one line for an error, a traceback with --debug."""

import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner

from pipeline.base.resume import ROOT
from steer.app import app

HEAVY = ("torch", "cv2", "h5py", "open3d", "matplotlib", "scipy", "plotly", "pykitti", "tqdm", "pandas", "rich", "dvc")
VERBS = {"measure", "predict", "import", "show"}


def test_help_imports_nothing_large() -> None:
    code = f"import sys, steer.app; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_help_of_each_verb_has_an_example() -> None:
    listed = CliRunner().invoke(app, ["--help"]).stdout.partition("Commands:")[2]
    assert {line.split()[0] for line in listed.splitlines() if line.startswith("  ") and line[2] != " "} == VERBS
    for verb in VERBS:
        text = CliRunner().invoke(app, [verb, "--help"]).stdout
        assert f"steer {verb} " in text.replace(f"steer {verb} [OPTIONS]", "")


def test_error_is_one_line_and_debug_shows_the_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "steer.app", "show", str(tmp_path / "none")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"error: {tmp_path}/none: ")
    assert done.stderr.count("\n") == 1
    done = subprocess.run([*command, "--debug"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "Traceback" in done.stderr
