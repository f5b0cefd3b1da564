"""Edit cost: which stages run again after a file was edited, by the parsed dvc.yaml; `dvc status` confirms it."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.base.resume import ROOT
from tests import scratch

MODELS = {
    "plain": {"input": "semantic", "spatial": "gnn", "temporal": "ncp", "window": 8},
    "attention": {"input": "semantic", "spatial": "gatv2", "temporal": "lstm", "window": 8},
}
ENTRIES: dict[str, dict[str, Any]] = {"graphs": {"semantic": {"source": "clouds/pseudo"}}, "models": MODELS}
NETWORKS = {"encoder", "perception", "train@plain", "train@attention"}  # hours on KITTI
TRAIN = {f"{stage}@{model}" for stage in ("train", "evaluate") for model in MODELS}


def stages_run_by(file: str) -> set[str]:
    """Return the stages with a dependency that covers a file, without `check`."""
    found = set()
    for name, stage in yaml.safe_load((ROOT / "dvc.yaml").read_text())["stages"].items():
        entries = ENTRIES[stage["foreach"][2:-1]] if "foreach" in stage else {"": {}}
        for key, entry in entries.items():
            for template in stage.get("do", stage)["deps"]:
                dependency = re.sub(r"\$\{item\.(\w+)\}", lambda match, entry=entry: str(entry[match[1]]), template)
                if file == dependency or file.startswith(f"{dependency}/"):
                    found.add(f"{name}@{key}" if key else name)
    return found - {"check"}


def files(pattern: str) -> list[str]:
    paths = sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern) if path.name != "__init__.py")
    assert paths, pattern
    return paths


@pytest.mark.parametrize("pattern", ["pipeline/train/*.py", "models/steering/core/**/*.py"])
def test_the_trainer_and_steering_networks_run_neither_encoder_nor_graphs(pattern: str) -> None:
    for file in files(pattern):
        assert stages_run_by(file) <= TRAIN | {"report", "check"}, file
    assert stages_run_by("pipeline/train/fit.py") >= TRAIN


@pytest.mark.parametrize("folder", ["spatial", "temporal"])
def test_a_network_trains_the_models_that_use_it(folder: str) -> None:
    for file in [*files(f"models/steering/{folder}/*.py"), f"models/steering/{folder}/new.py"]:
        users = {name for name, model in MODELS.items() if model[folder] == Path(file).stem}
        assert stages_run_by(file) == {f"{stage}@{model}" for stage in ("train", "evaluate") for model in users}


@pytest.mark.parametrize(
    ("pattern", "stages"),
    [
        ("pipeline/town/*.py", {"town"}),
        ("pipeline/encoder/fit.py", {"encoder"}),
        ("pipeline/motion/pose.py", {"motion"}),
        ("pipeline/graphs/neighbourhoods.py", {"graphs@semantic"}),
        ("pipeline/graphs/cloud.py", {"clouds", "graphs@semantic"}),
        ("pipeline/sections/train.py", {"train@plain", "train@attention"}),
        ("models/encoder/backbones/*.py", {"encoder", "perception", "scores"}),
        ("stages/town.py", {"town"}),
        ("stages/graphs.py", {"graphs@semantic"}),
        ("stages/train.py", {"train@plain", "train@attention"}),
    ],
)
def test_other_edits_run_their_own_stage(pattern: str, stages: set[str]) -> None:
    for file in files(pattern):
        assert stages_run_by(file) == stages, file


@pytest.mark.slow
def test_dvc_runs_what_dvc_yaml_promises_and_no_name_as_a_command(chain: Path, tmp_path: Path) -> None:
    folder = scratch.duplicate(chain, tmp_path / "copy")
    leftovers = ("pipeline/train/__pycache__/fit.cpython-311.pyc", "pipeline/train/.fit.py.swp", "stages/x.py~")
    for name in leftovers:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("# an editor's")
    assert scratch.changed(folder) == set()
    edits = ("models/steering/spatial/gnn.py", "models/steering/spatial/gatv2.py", "pipeline/motion/pose.py")
    for name in edits:
        with (folder / name).open("a") as file:
            file.write("# an edit\n")
    model = scratch.MODEL
    assert scratch.changed(folder) == {"check", f"train@{model}", f"evaluate@{model}", "motion"}

    name = "x';touch pwned;'$(touch pwned)\"`touch pwned`"
    scratch.edit_params(folder, graphs={name: {"source": "clouds/pseudo", "points": 100, "k": 6}})
    output = scratch.run(folder, "dvc", "repro", "--single-item", "graphs", check=False)
    assert "error:" in output
    assert not (folder / "pwned").exists()
