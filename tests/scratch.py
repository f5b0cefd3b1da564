"""Scratch copies of the project, a small chain in one, and DVC run there as a user runs it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml
from dvc.utils.serialize import modify_yaml

from pipeline.base import resume

STAGES = (
    "sample", "ingest", "encoder", "perception", "motion", "labels", "scores", "clouds", "graphs", "train",
    "evaluate", "report",
)  # fmt: skip
MODEL = "sa-gnn-ncp"


def copy(folder: Path) -> Path:
    """Copy the repository as git sees it, with edits that are not committed, into a repository of its own."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"],
        cwd=resume.ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    for name in listed:
        if (resume.ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(resume.ROOT / name, folder / name)
    subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
    commit(folder, "scratch")
    return folder


def commit(folder: Path, message: str) -> None:
    """Commit all that git sees of a scratch copy."""
    subprocess.run(["git", "add", "-A"], cwd=folder, check=True)
    who = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    subprocess.run(["git", *who, "commit", "-qm", message], cwd=folder, check=True)


def environment(folder: Path, **more: str) -> dict[str, str]:
    """Return the variables for commands of this environment that run the code of a folder."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    fixed = {"PATH": path, "DVC_NO_ANALYTICS": "1", "PYTHONPATH": str(folder), "STEER_WORKERS": "1"}
    return {**os.environ, **fixed, **more}


def run(folder: Path, *command: str, check: bool = True) -> str:
    """Run a command in a scratch copy, on its code, and return its output. Without `check` it must fail."""
    done = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    assert not check or done.returncode == 0, output
    assert check or done.returncode != 0, output
    return output


def stages_run(output: str) -> list[str]:
    """Return the stages that DVC ran, without those that it restored from its cache."""
    return [line.split("'")[1] for line in output.splitlines() if line.startswith("Running stage")]


def outputs(folder: Path, *stages: str) -> dict[str, bytes]:
    """Return relative path → contents of the outputs of stages."""
    paths = [path for stage in stages for path in (folder / "data" / stage).rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def code_block(part: str) -> str:
    """Return the first code block of README.md or docs/ that contains a text, without its fences."""
    for page in (resume.ROOT / "README.md", *sorted((resume.ROOT / "docs").glob("*.md"))):
        for block in page.read_text().split("```")[1::2]:
            if part in block:
                return block
    raise LookupError(f"no code block of README.md or docs/ contains {part!r}")


def small_chain(folder: Path) -> Path:
    """Run the complete chain in a scratch copy with four short drives; its output goes to ``chain.log``."""
    copy(folder)
    params = yaml.safe_load((folder / "params.yaml").read_text())
    drives = {"train": ["2026_01_01_drive_0001..0002"], "val": ["2026_01_02_drive_0001"]}
    edit_params(
        folder,
        sample=params["sample"] | {"image_size": [64, 208], "frames": {"train": 24, "val": 14, "test": 20}},
        ingest=params["ingest"] | {"image_size": [64, 208], "drives": drives | {"test": ["2026_01_03_drive_0001"]}},
        encoder=params["encoder"] | {"weights": None, "epochs": 2, "frames": 24},
        clouds=params["clouds"] | {"max_points": 3000},
        graphs={
            "semantic": params["graphs"]["semantic"] | {"points": 200},
            "lidar": {"source": "clouds/lidar", "points": 200, "k": 6},
        },
        train=params["train"] | {"epochs": 3, "seeds": [0]},
        evaluate=params["evaluate"] | {"bootstrap_samples": 200},
    )
    (folder / "chain.log").write_text(run(folder, "dvc", "repro"))
    commit(folder, "chain")
    return folder


def duplicate(chain: Path, folder: Path) -> Path:
    """Copy a scratch copy with its data, DVC's cache and its history."""
    return Path(shutil.copytree(chain, folder, symlinks=True))


def edit_params(folder: Path, **sections: Any) -> None:
    """Replace sections of a scratch copy's params.yaml, in the format of DVC's own edits."""
    with modify_yaml(str(folder / "params.yaml")) as params:
        params.update(sections)
