"""The installed wheel: steer measures and predicts without a checkout."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import pandas as pd
import pytest

from pipeline.base.checkout import ROOT

pytestmark = pytest.mark.slow

FOLDERS = (
    "footage",
    "pipeline",
    "models",
    "stages",
    "steer",
    "presets",
    "benchmarks",
    "docs",
    "tests",
)
IMAGES = ROOT / "examples/street"
LENS = ("--K", "172.9,172.9,154.4,44.95", "--fps", "10", "--no-video")
# The environment of the tests, without the checkout.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Return the wheel of a copy of the checkout, as a build leaves files beside the code."""
    source = tmp_path_factory.mktemp("source")
    for name in FOLDERS:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    (source / "runs/kitti/pipeline").mkdir(parents=True)
    (source / "runs/kitti/pipeline/code.py").touch()

    out = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", out, source)
    return next(out.iterdir())


@pytest.fixture(scope="module")
def scripts(wheel, tmp_path_factory) -> Path:
    """Return the scripts of an environment with the wheel and the tests' other packages."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, symlinks=True)
    python = folder / "bin/python"

    # Python adds the folder in a .pth file to its path, but does not read the .pth files in that
    # folder, of which one adds the checkout.
    command = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    Path(done.stdout.strip(), "tests.pth").write_text(sysconfig.get_path("purelib"))
    pip("--python", python, "install", "--no-deps", "--no-index", wheel)
    return python.parent


@pytest.fixture
def steer(scripts, tmp_path) -> Callable[..., str]:
    """Return a function that runs steer in another folder and returns what it prints."""
    environment = ENVIRONMENT | {"XDG_CACHE_HOME": str(tmp_path / "cache")}

    def run(*arguments: object, status: int = 0) -> str:
        command = [scripts / "steer", *map(str, arguments)]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == status, done.stderr
        return done.stderr if status else done.stdout

    return run


def pip(*arguments: object) -> None:
    command = [sys.executable, "-m", "pip", *map(str, arguments)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_wheel_has_the_code_of_steer_alone(wheel, scripts):
    folders = {name.partition("/")[0] for name in ZipFile(wheel).namelist()}
    metadata = f"{wheel.name.removesuffix('-py3-none-any.whl')}.dist-info"
    assert folders == {"footage", "models", "pipeline", "steer", metadata}
    command = [scripts / "python", "-c", "from pipeline.base.checkout import ROOT; print(ROOT)"]
    done = subprocess.run(command, cwd="/", env=ENVIRONMENT, capture_output=True, text=True)
    assert Path(done.stdout.strip()).is_relative_to(scripts.parent)


def test_motion_is_measured_and_angles_are_predicted_without_a_checkout(steer, tmp_path):
    version = steer("--version").split()[1:]
    steer("measure", IMAGES, *LENS, "--encoder", "models/encoder/sample")
    quality = json.loads((tmp_path / "out/street/quality.json").read_text())
    assert [quality["version"]] == version
    assert quality["revision"] is None
    assert pd.read_csv(tmp_path / "out/street/motion.csv")["valid"].sum() == 7

    steer("predict", IMAGES, *LENS, "--model", "models/steering/sample")
    steering = pd.read_csv(tmp_path / "out/street-2/steering.csv")
    assert steering["predicted_rad"].iloc[-1] == pytest.approx(0.298, abs=0.05)
    steer("predict", IMAGES, *LENS, "--model", "models/steering/sample_path")


def test_an_import_needs_a_checkout(steer):
    text = steer("import", "monday.mp4", "--fov", "65", status=1)
    assert text.startswith("error: steer import needs a checkout of the project. Clone it: git")
    assert text.count("\n") == 1
